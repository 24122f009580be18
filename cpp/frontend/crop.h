// The points of a scan within a local cloud.
#pragma once

#include <array>
#include <cmath>
#include <cstddef>
#include <vector>

#include "common/rigid.h"

namespace segloc {

// Nearer than `radius` to the z axis, and to the x-y plane.
inline bool is_near_axis(const std::array<double, 3>& p, double radius) {
  return p[0] * p[0] + p[1] * p[1] < radius * radius && std::abs(p[2]) < radius;
}

// The points, (n, 3) row-major, moved by T; of those that are then near the z axis.
std::vector<float> moved_crop(const float* points, std::size_t n, const Rigid& T, double radius);

// The points no farther than `range` from the origin.
std::vector<float> within_range(const float* points, std::size_t n, double range);

}  // namespace segloc
