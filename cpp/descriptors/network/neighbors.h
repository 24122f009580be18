// Dilated nearest neighbours of many clouds: the neighbour search of the network by itself.
#pragma once

#include <cstddef>
#include <cstdint>

#include "simd/kernels.h"

namespace segloc {

// Floats of scratch memory that the kernel needs.
static constexpr std::size_t neighbor_scratch_size(std::size_t sources) {
  return 5 * padded(sources, 16) + 8 * 16;
}

// result (clouds, queries, neighbors): for each of the first `queries` points of each cloud
// (clouds, n, 3) the neighbors * dilation nearest of its first `sources` points, sorted by distance
// and then by index, the point itself included; of these every dilation-th.
void dilated_neighbors(const float* points, std::size_t clouds, std::size_t n, std::size_t sources,
                       std::size_t queries, int neighbors, int dilation, Isa isa, int threads,
                       int64_t* result);

}  // namespace segloc
