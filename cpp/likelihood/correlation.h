// Fit of a query cloud to the map at many shifts and headings around a pose.
#pragma once

#include <cstddef>
#include <cstdint>
#include <vector>

#include "likelihood/point_index.h"

namespace segloc {

struct CorrelationOptions {
  double cell = 0.5;        // edge of the occupancy grid, and the step of the shifts, metres
  double half_width = 15;   // largest shift along x and y, metres
  double range = 30;        // range of the query points, metres
  std::size_t cells = 600;  // most occupied cells of the query
};

// (Headings, shifts along y, shifts along x) row-major: four times the occupied cells of the query
// that are occupied in the map, too, twice those that lie beside such a cell, and once those where
// the map has nothing all around; and how many cells of the query were used at each heading.
struct Correlation {
  std::vector<std::uint16_t> counts;
  std::vector<std::uint16_t> used;
  std::size_t width = 0;  // shifts along each axis
};

// Correlates occupancy grids exhaustively, as E. Olson does ("Real-Time Correlative Scan Matching",
// ICRA 2009), with layers of height. Query points, (m, 3), are turned about the z axis of their
// frame by each heading (radians), taken through a row-major 4 x 4 transform, and shifted along
// the map's x and y. Cells are occupied by points of about the same height; beside one lie eight.
Correlation correlate(const PointIndex& map, const float* points, std::size_t m,
                      const double* transform, const std::vector<double>& headings,
                      const CorrelationOptions& options);

}  // namespace segloc
