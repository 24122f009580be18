// Counts the segments of a query that agree with any given poses.
#pragma once

#include <cstddef>
#include <cstdint>
#include <vector>

#include "common/rigid.h"

namespace segloc {

class Agreement {
 public:
  struct Match {
    double from[3], to[3];  // centroids: in the local frame and in the map
    std::size_t object;     // of the query; an object may have several segments
  };
  struct Tolerance {
    double across, height;  // metres
  };

  // Objects are numbered up to `objects`.
  Agreement(std::vector<Match> matches, std::size_t objects, const Tolerance& tolerance);

  // Distinct objects with a match that fits the pose T_map_local.
  std::size_t count(const Rigid& T) const;

 private:
  // The strip of the map that x lies in; the first or the last one if it lies outside.
  std::size_t strip_of(double x) const;

  std::vector<Match> matches_;       // strip by strip
  std::vector<std::size_t> starts_;  // of the strips, and the end of the last one
  std::size_t objects_;
  Tolerance tolerance_;
  double reach_ = 0.0;  // largest range of a segment, metres
  double low_ = 0.0, strips_per_metre_ = 0.0;
};

}  // namespace segloc
