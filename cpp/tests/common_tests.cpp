// The thread pool.
#include <atomic>
#include <stdexcept>

#include "common/parallel.h"
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

}  // namespace
}  // namespace segloc

void common_tests() { segloc::threads(); }
