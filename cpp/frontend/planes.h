// Normals of what is flat in a cloud: floors, walls, ceilings.
#pragma once

#include <cstddef>
#include <vector>

namespace segloc {

struct PlaneOptions {
  double radius = 1.0;          // metres; half of it where enough points lie so near
  std::size_t min_points = 10;  // around a point that can be judged
  double thickness = 0.05;      // standard deviation across, metres
  std::size_t most = 3000;      // points that are judged: evenly many of the cloud
};

// Unit normals, of either sign, of the judged points whose neighbourhood is flat, (M, 3) row-major.
// Throws std::invalid_argument where the points lie too far apart for the radius.
std::vector<float> plane_normals(const float* points, std::size_t n, const PlaneOptions& options);

}  // namespace segloc
