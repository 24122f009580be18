// Voxel grid: one point, the mean, for every occupied voxel.
#pragma once

#include <cstddef>
#include <vector>

namespace segloc {

// The mean point of every occupied voxel of edge `size` metres, in the order of the voxels:
// (m, 3) row-major. The lattice is fixed to the frame's origin.
std::vector<float> voxel_grid(const float* points, std::size_t n, double size);

}  // namespace segloc
