// The thread pool, and how many threads it may have.
#include <atomic>
#include <stdexcept>
#include <thread>

#include "common/parallel.h"
#include "common/portability.h"
#include "common/processors.h"
#include "tests/check.h"

namespace segloc {
namespace {

void threads() {
  for (const int workers : {1, 2, 8}) {
    std::vector<std::atomic<int>> seen(1000);
    parallel_for(1000, 7, workers, [&](std::size_t begin, std::size_t end, int worker) {
      CHECK(worker >= 0 && worker < workers);
      parallel_for(3, 1, 2, [&](std::size_t, std::size_t, int) {});
      for (std::size_t i = begin; i < end; ++i) ++seen[i];
    });
    for (const auto& count : seen) CHECK(count == 1);
  }
  const auto stop = [](std::size_t begin, std::size_t, int) {
    if (begin == 50) throw std::runtime_error("stop");
  };
  CHECK_THROWS(parallel_for(100, 1, 4, stop));
}

// Many small jobs of several callers at once: none is lost, and none ends before its last chunk.
void callers() {
  std::vector<std::thread> others;
  std::atomic<int> wrong{0};
  for (int caller = 0; caller < 4; ++caller) {
    others.emplace_back([&wrong, caller] {
      for (std::size_t round = 0; round < 500; ++round) {
        std::vector<std::size_t> squares(1 + (round * 7 + std::size_t(caller)) % 50);
        parallel_for(squares.size(), 3, 2 + caller, [&](std::size_t begin, std::size_t end, int) {
          for (std::size_t i = begin; i < end; ++i) squares[i] = i * i;
        });
        for (std::size_t i = 0; i < squares.size(); ++i) wrong += squares[i] != i * i;
      }
    });
  }
  for (std::thread& other : others) other.join();
  CHECK(wrong == 0);
}

void processors() {
  CHECK(processors_of_quota("max 100000") == 0 && processors_of_quota("") == 0);
  CHECK(processors_of_quota("-1 100000") == 0 && processors_of_quota("100000 0") == 0);
  CHECK(processors_of_quota("150000 100000\n") == 2 && processors_of_quota("5000 100000") == 1);
  CHECK(processors_of_quota("1e300 1e-300") == 4096);
  CHECK(usable_processors() >= 1 && resolve_threads(0) <= usable_processors());
  CHECK(resolve_threads(7) == 7 && resolve_threads(2'000'000'000) == 256);
}

// The processor's features are those of the compiler's library.
void instruction_set_tests() {
#if defined(__x86_64__) && !defined(__clang__)  // whose library need not be there
  __builtin_cpu_init();
  const CpuFeatures features = cpu_features();
  CHECK(features.avx2 == (__builtin_cpu_supports("avx2") != 0));
  CHECK(features.fma == (__builtin_cpu_supports("fma") != 0));
  CHECK(features.avx512f == (__builtin_cpu_supports("avx512f") != 0));
  CHECK(features.avx512dq == (__builtin_cpu_supports("avx512dq") != 0));
  CHECK(features.avx512bw == (__builtin_cpu_supports("avx512bw") != 0));
  CHECK(features.avx512vl == (__builtin_cpu_supports("avx512vl") != 0));
#endif
}

}  // namespace
}  // namespace segloc

void common_tests() {
  segloc::threads();
  segloc::callers();
  segloc::processors();
  segloc::instruction_set_tests();
}
