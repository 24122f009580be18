// How many segments of a query agree with poses that were not estimated of them.
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
    std::size_t object;     // which of the query's: some are several segments
  };
  struct Tolerance {
    double across, height;  // metres
  };

  // Objects are numbered up to `objects`.
  Agreement(std::vector<Match> matches, std::size_t objects, const Tolerance& tolerance);

  // Distinct objects with a match that fits the pose T_map_local.
  std::size_t count(const Rigid& T) const;

 private:
  std::vector<Match> matches_;  // by where they are in the map along x
  std::size_t objects_;
  Tolerance tolerance_;
  double reach_ = 0.0;  // a query sees no farther, metres
};

}  // namespace segloc
