// What a query shows standing where the map is known to be free.
#pragma once

#include <cstddef>

#include "likelihood/point_index.h"

namespace segloc {

struct IntrusionOptions {
  double range = 30;        // query points this near the sensor are used, metres
  double bin_deg = 2;       // width of a pixel of a range image, degrees
  double radius = 0.5;      // a query point with a map point so near stands there, metres
  double margin = 0.7;      // map points lie so far behind free space, metres
  double half_width = 0.2;  // of what a map point stands for: the map's cloud is thinned, metres
};

struct Intrusion {
  std::size_t used = 0;       // query points within the range
  std::size_t intruding = 0;  // those that stand in free space
};

// Query points, (m, 3), are taken through a row-major 4 x 4 transform to the map's frame. From each
// viewpoint, (v, 3), where the sensor was when the map was made, a range image of the map tells
// what is free: all that is measured in a direction, and about it, lies behind. G. Kim, A. Kim
// ("Remove, then Revert", IROS 2020) compare range images of a map and of its scans in the same
// way.
Intrusion intrusion(const PointIndex& map, const float* points, std::size_t m,
                    const double* transform, const double* viewpoints, std::size_t v,
                    const IntrusionOptions& options);

}  // namespace segloc
