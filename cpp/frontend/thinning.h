// A cloud thinned to the point nearest to the centre of each voxel.
#pragma once

#include <cstddef>
#include <cstdint>
#include <vector>

namespace segloc {

// Rows of n points, (n, 3) row-major, one for each occupied voxel: floor((origin + point) / voxel),
// in the order of x, y, z. Of points equally near the centre the one of least x, y, z stays. Throws
// std::invalid_argument where they span more than 2^21 voxels along an axis.
std::vector<std::uint32_t> central_points(const float* points, std::size_t n, const double* origin,
                                          double voxel);

}  // namespace segloc
