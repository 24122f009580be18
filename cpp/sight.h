#pragma once
// Which points of a map a live cloud, seen from one place, has as well, and which it looks through.

#include <cstddef>
#include <cstdint>

namespace segloc {

struct SightOptions {
  double range = 30.0;    // map points are judged up to here, metres
  double near = 0.4;      // a map point with a live point so near is seen, metres
  double margin = 0.7;    // what lies so far behind a map point is behind it, metres
  double slant = 0.05;    // the same, as a share of the range
  double bin_deg = 2.0;   // width of a pixel of the range image
  double above = 0.5;     // map points lower above the live ground are not judged, metres
};

struct Sight {
  std::int64_t seen = 0;
  std::int64_t through = 0;
};

// `structure` (n, 3) and `ground` (g, 3) are the live cloud in its own frame, whose z axis is up and
// whose origin is the sensor; `site` (m, 3) are points of the map, and T (4, 4) takes them to that
// frame. A map point is looked through where its pixel of the live range image is measured, and all
// that is measured in that pixel and about it lies well behind the point.
Sight sight(const float* structure, std::size_t n, const float* ground, std::size_t g,
            const float* site, std::size_t m, const double* T, const SightOptions& options);

}  // namespace segloc
