// Spacing of the points of a cloud.
#pragma once

#include <cstddef>

namespace segloc {

// The median distance from a point of (n, 3) to its second nearest neighbour, at least `least`. (A
// surface along the face between two voxels gives a pair of points in each, so the nearest
// neighbour is not representative.) At most `most` points are sampled evenly. It is fast if
// neighbours are close in the input, as after a voxel grid, and most have neighbours within
// `least`.
double point_spacing(const float* points, std::size_t n, double least, std::size_t most);

}  // namespace segloc
