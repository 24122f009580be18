// How far apart the points of a cloud are.
#pragma once

#include <cstddef>

namespace segloc {

// The median distance from a point of (n, 3) to the second nearest other one, or `least` where it
// is less. (A surface that runs along the face between two voxels gives a pair of points in each:
// the nearest says nothing.) Of at most `most` points, evenly drawn. It is quick where points near
// each other in the cloud are near each other in the input, as after a voxel grid, and most have
// neighbours within `least`.
double point_spacing(const float* points, std::size_t n, double least, std::size_t most);

}  // namespace segloc
