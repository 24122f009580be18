// Query points that occupy free space of the map.
#pragma once

#include <cstddef>

#include "likelihood/point_index.h"

namespace segloc {

struct IntrusionOptions {
  double range = 30;        // range of the query points, metres
  double bin_deg = 2;       // width of a pixel of a range image, degrees
  double radius = 0.5;      // radius within which a query point is on the map, metres
  double margin = 0.7;      // distance of free space before a map point, metres
  double half_width = 0.2;  // half width of a point of the thinned map, metres
};

struct Intrusion {
  std::size_t used = 0;       // query points within the range
  std::size_t intruding = 0;  // those in free space
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
