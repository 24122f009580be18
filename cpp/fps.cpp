#include "fps.h"

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
  constexpr std::size_t kGrain = 8;
  parallel_for(clouds, kGrain, threads, [&](std::size_t begin, std::size_t end, int) {
    FpsScratch scratch[2] = {FpsScratch(n), FpsScratch(n)};
    const auto load = [&](std::size_t index, int slot) {
      const FpsCloud cloud = scratch[slot].cloud(order + index * samples);
      const float* p = points + index * n * 3;
      for (std::size_t i = 0; i < n; ++i) {
        cloud.x[i] = p[3 * i];
        cloud.y[i] = p[3 * i + 1];
        cloud.z[i] = p[3 * i + 2];
      }
      return cloud;
    };
    std::size_t i = begin;
    for (; i + 1 < end; i += 2) k.fps_pair(load(i, 0), load(i + 1, 1), n, samples);
    if (i < end) k.fps(load(i, 0), n, samples);
  });
}

}  // namespace segloc
