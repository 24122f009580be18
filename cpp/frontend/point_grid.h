// Points in a hashed grid: neighbour search in clouds of any extent.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <vector>

#include "common/cells.h"
#include "frontend/grid_cells.h"
#include "simd/kernels.h"

namespace segloc {

class PointGrid {
 public:
  using Point = std::array<float, 3>;

  // Copies n points, (n, 3) row-major, and sorts them by cell, within square tiles of the plane of
  // `tile_cells` cells a side, by y and x, if that is positive. Queries take any radius up to
  // `radius`. Throws std::invalid_argument where the points lie too far apart for that radius.
  // `rows` receives the row of each in the input.
  PointGrid(const float* points, std::size_t n, double radius, std::int64_t tile_cells = 0,
            std::vector<std::uint32_t>* rows = nullptr);

  std::size_t size() const { return x_.size() - kPad; }
  double radius() const { return cell_ / 2; }
  Point operator[](std::size_t i) const {
    return {x_[i], y_[i], z_[i]};
  }  // in the grid's own order

  // For the kernels.
  GridCells cells() const {
    return {table_.data(), ranges_.data(), x_.data(), y_.data(),
            z_.data(),     bits_,          cell_,     per_metre_};
  }

  // Sums over the points within the distance, squared, of places, (count, 3).
  void sums_within(const float* places, std::size_t count, float distance2, PointSums* sums) const;
  // Squared distances from places, (count, 3), to the nearest point of each; more than the limit
  // where none is within it. If it is `enough` or less, to any point as near as that.
  void nearest_squared(const float* places, std::size_t count, float limit, float enough,
                       float* squared) const;
  // The nearest point to each place of those within the limit, squared; of several, the first one
  // of the cell of the least key. `next` is exact up to `lead`, squared.
  void nearest(const float* places, std::size_t count, float limit, float lead,
               GridNearest* found) const;

 private:
  static constexpr std::size_t kPad = 16;

  // Runs of points, those of each cell together.
  static void sort_by_tile(CellRuns& sorted, const float* points, double tile);
  void fill(const std::vector<GridRange>& found);

  double cell_, per_metre_;
  int bits_ = 4;
  std::vector<float> x_, y_, z_;  // kPad infinite values behind the last: vectors are read there
  std::vector<GridBlock> table_;
  std::vector<GridRange> ranges_;
};

}  // namespace segloc
