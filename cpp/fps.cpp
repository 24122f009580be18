#include "fps.h"

#include <algorithm>

#include "parallel.h"

namespace segloc {

FpsScratch::FpsScratch(std::size_t capacity)
    : padded_(padded(capacity, kFpsGroup)),
      memory_(4 * padded_ + fps_group_max_size(capacity)) {}

FpsCloud FpsScratch::cloud(int32_t* order) {
  float* m = memory_.data();
  return {m, m + padded_, m + 2 * padded_, m + 3 * padded_, m + 4 * padded_, order};
}

void farthest_points(const float* points, std::size_t clouds, std::size_t n, std::size_t samples,
                     Isa isa, int threads, int32_t* order) {
  if (samples == 0 || n == 0) return;
  const Kernels& k = kernels(isa);
  constexpr std::size_t kGrain = 8, kTogether = 4;
  parallel_for(clouds, kGrain, threads, [&](std::size_t begin, std::size_t end, int) {
    FpsScratch scratch[kTogether] = {FpsScratch(n), FpsScratch(n), FpsScratch(n), FpsScratch(n)};
    for (std::size_t first = begin; first < end; first += kTogether) {
      const std::size_t count = std::min(kTogether, end - first);
      FpsCloud together[kTogether];
      for (std::size_t c = 0; c < count; ++c) {
        together[c] = scratch[c].cloud(order + (first + c) * samples);
        const float* p = points + (first + c) * n * 3;
        for (std::size_t i = 0; i < n; ++i) {
          together[c].x[i] = p[3 * i];
          together[c].y[i] = p[3 * i + 1];
          together[c].z[i] = p[3 * i + 2];
        }
      }
      k.fps(together, count, n, samples);
    }
  });
}

}  // namespace segloc
