#include "descriptors/fps.h"

#include <algorithm>

#include "common/aligned.h"
#include "common/parallel.h"

namespace segloc {

void farthest_points(const float* points, std::size_t clouds, std::size_t n, std::size_t samples,
                     Isa isa, int threads, int32_t* order) {
  if (samples == 0 || n == 0) return;
  const Kernels& k = kernels(isa);
  constexpr std::size_t kGrain = 8, kTogether = 4;
  parallel_for(clouds, kGrain, threads, [&](std::size_t begin, std::size_t end, int) {
    const std::size_t size = padded(fps_scratch_size(n), 16), stride = padded(n, kFpsGroup);
    AlignedFloats scratch(kTogether * size);
    for (std::size_t first = begin; first < end; first += kTogether) {
      const std::size_t count = std::min(kTogether, end - first);
      FpsCloud together[kTogether];
      for (std::size_t c = 0; c < count; ++c) {
        float* x = scratch.data() + c * size;
        together[c] = {x, order + (first + c) * samples, n, samples};
        const float* p = points + (first + c) * n * 3;
        for (std::size_t i = 0; i < n; ++i) {
          x[i] = p[3 * i];
          x[i + stride] = p[3 * i + 1];
          x[i + 2 * stride] = p[3 * i + 2];
        }
      }
      k.fps(together, count, fps_groups(n));
    }
  });
}

}  // namespace segloc
