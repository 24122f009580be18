// Height of points above a ground surface that may slope and lie under vegetation.
#pragma once

#include <cstddef>
#include <vector>

namespace segloc {

struct GroundOptions {
  double cell = 1.0;       // edge of a grid cell, metres
  double max_slope = 0.2;  // rise over run; steeper things are not ground
  double outlier = 0.3;    // cells that differ by less than this support each other, metres
};

// The ground is the highest surface that lies under the lowest point of every cell and is nowhere
// steeper than max_slope: g(c) = min over cells n of (lowest(n) + max_slope * |c - n|).
// Returns the height of each of the n points above it.
std::vector<float> heights_above_ground(const float* points, std::size_t n,
                                        const GroundOptions& options);

// The points higher than the cut, and the others, in their order.
void split_by_height(const float* points, const float* heights, std::size_t n, double cut,
                     std::vector<float>& above, std::vector<float>& below);

}  // namespace segloc
