// Normals of flat surfaces in a cloud: floors, walls, ceilings.
#pragma once

#include <cstddef>
#include <vector>

namespace segloc {

struct PlaneOptions {
  double radius = 1.0;          // metres; halved if there are enough points
  std::size_t min_points = 10;  // fewest neighbours of a point
  double thickness = 0.05;      // standard deviation across, metres
  std::size_t most = 3000;      // points used, evenly spread over the cloud
};

// Unit normals, of either sign, of points with a flat neighbourhood, (M, 3) row-major. Throws
// std::invalid_argument if the points lie too far apart for the radius.
std::vector<float> plane_normals(const float* points, std::size_t n, const PlaneOptions& options);

}  // namespace segloc
