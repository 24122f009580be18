// Farthest-point sampling of many small clouds.
#pragma once

#include <cstddef>
#include <cstdint>

#include "simd/kernels.h"

namespace segloc {

// Floats of scratch memory for a cloud of n points.
constexpr std::size_t fps_scratch_size(std::size_t n) {
  return 4 * padded(n, kFpsGroup) + fps_group_max_size(fps_groups(n));
}

// order (clouds, samples): for each of the clouds (clouds, n, 3), indices in the order in which
// farthest-point sampling takes its points. It starts at the point farthest from the centroid; each
// further one is the farthest from those taken so far, the lowest index among equals. No index is
// taken twice. The same on every instruction set and for any number of threads.
void farthest_points(const float* points, std::size_t clouds, std::size_t n, std::size_t samples,
                     Isa isa, int threads, int32_t* order);

}  // namespace segloc
