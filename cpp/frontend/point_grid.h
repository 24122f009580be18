// Points in a hashed grid: neighbour search in clouds of any extent.
#pragma once

#include <array>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <vector>

#include "common/cells.h"

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

  // Calls visit(i, squared distance) for points around p: all those within `radius`, and others.
  template <typename Visit>
  void visit(const Point& p, double radius, Visit&& visit) const;

  // Writes the points within the distance, squared, of p, and returns how many. `radius` is no less
  // than its root, and `found` has room for all points and kPad more.
  std::size_t within(const Point& p, double radius, float distance2, std::uint32_t* found) const;
  static constexpr std::size_t kPad = 16;

  // Squared distance to the nearest point, or more than the limit where none is within it.
  float nearest_squared(const Point& p, float limit) const;
  // Whether any point is within the limit.
  bool is_near(const Point& p, float limit) const;

  struct Nearest {
    std::uint32_t point;  // of those that are as near the first one visited; kNone where none is
    float squared, next;  // distances to it and to the next one; the limit where they are farther
  };
  static constexpr std::uint32_t kNone = 0xFFFFFFFFu;
  // The nearest of the points that are closer than the limit.
  Nearest nearest(const Point& p, float limit) const;
  // No point is nearer than this; no more than a cell's width past `radius`, and 0 if too far away.
  double clearance(const Point& p, double radius) const;

 private:
  // Cells of either side of the origin.
  static constexpr std::int64_t kAxis = std::int64_t{1} << 20;
  static constexpr double kSlack = 1e-9;  // cells by which rounding may move a place

  struct Range {  // of the points of a cell
    std::uint32_t begin, end;
  };
  // Four by four by four cells: a neighbourhood touches one or two, most of whose cells are empty.
  struct Block {
    std::uint64_t key, cells;  // a bit for each cell that has points; free where there is none
    std::uint32_t first;       // of their ranges
  };
  static constexpr int kShift = 2;
  static constexpr std::int64_t kInside = (1 << kShift) - 1;

  static std::uint64_t key(std::int64_t x, std::int64_t y, std::int64_t z) {
    return (static_cast<std::uint64_t>(x + kAxis) << 42) |
           (static_cast<std::uint64_t>(y + kAxis) << 21) | static_cast<std::uint64_t>(z + kAxis);
  }
  static std::uint64_t bit(std::int64_t x, std::int64_t y, std::int64_t z) {
    return std::uint64_t{1} << ((x & kInside) << (2 * kShift) | (y & kInside) << kShift |
                                (z & kInside));
  }
  static std::size_t ones(std::uint64_t v) {  // the instruction is not on every x86
    v -= (v >> 1) & 0x5555555555555555ull;
    v = (v & 0x3333333333333333ull) + ((v >> 2) & 0x3333333333333333ull);
    v = (v + (v >> 4)) & 0x0f0f0f0f0f0f0f0full;
    return (v * 0x0101010101010101ull) >> 56;
  }
  // Where a block is or would be.
  std::size_t slot_of(std::uint64_t key) const {
    std::size_t slot = (key * 0x9E3779B97F4A7C15ull >> 20) & (table_.size() - 1);
    while (table_[slot].cells != 0 && table_[slot].key != key) {
      slot = (slot + 1) & (table_.size() - 1);
    }
    return slot;
  }

  // Runs of points, those of each cell together.
  static void sort_by_tile(CellRuns& sorted, const float* points, double tile);
  void fill(const std::vector<Range>& found);

  // The cells of a neighbourhood, whose blocks are looked for once.
  class Cells {
   public:
    Cells(const PointGrid& grid, const std::int64_t* low) : grid_(grid) {
      for (int a = 0; a < 3; ++a) low_[a] = low[a] >> kShift;
    }
    const Range* find(std::int64_t x, std::int64_t y, std::int64_t z) {
      const std::int64_t bx = x >> kShift, by = y >> kShift, bz = z >> kShift;
      const auto at =
          static_cast<std::size_t>((bx - low_[0]) << 2 | (by - low_[1]) << 1 | (bz - low_[2]));
      if (!(known_ >> at & 1u)) {
        known_ |= 1u << at;
        blocks_[at] = &grid_.table_[grid_.slot_of(key(bx, by, bz))];
      }
      const Block& block = *blocks_[at];
      const std::uint64_t cell = bit(x, y, z);
      if ((block.cells & cell) == 0) return nullptr;
      return &grid_.ranges_[block.first + ones(block.cells & (cell - 1))];
    }

   private:
    const PointGrid& grid_;
    std::int64_t low_[3];
    const Block* blocks_[8];
    unsigned known_ = 0;
  };

  // The square of the distance along an axis from a place in cell `own` to another cell.
  double gap(std::int64_t cell, std::int64_t own, double at) const {
    if (cell == own) return 0.0;
    const double first = static_cast<double>(cell) * cell_;
    const double d = cell > own ? first - at : at - (first + cell_);
    return d > 0.0 ? d * d : 0.0;
  }
  // The first and the last cell that a neighbourhood touches along each axis; false too far away.
  bool reach(const Point& p, double radius, std::int64_t* low, std::int64_t* high) const;
  // Calls take(range, key) for the cells around p, its own first, and then for those that may hold
  // a point as near as bound(), a squared distance.
  template <typename Bound, typename Take>
  void visit_cells(const Point& p, double radius, const Bound& bound, const Take& take) const;

  double cell_, per_metre_;
  std::vector<float> x_, y_,
      z_;  // with infinite ones at the end, so that vectors may be read there
  std::vector<Block> table_;  // open addressing
  std::vector<Range> ranges_;
};

inline bool PointGrid::reach(const Point& p, double radius, std::int64_t* low,
                             std::int64_t* high) const {
  for (int a = 0; a < 3; ++a) {
    const double at = p[a] * per_metre_, wide = radius * per_metre_ + kSlack;
    if (!(std::abs(at) < double(kAxis - 2))) return false;
    low[a] = floor_of(at - wide);
    high[a] = floor_of(at + wide);
  }
  return true;
}

template <typename Visit>
void PointGrid::visit(const Point& p, double radius, Visit&& visit) const {
  std::int64_t low[3], high[3];
  if (!reach(p, radius, low, high)) return;
  Cells cells(*this, low);
  for (std::int64_t x = low[0]; x <= high[0]; ++x) {
    for (std::int64_t y = low[1]; y <= high[1]; ++y) {
      for (std::int64_t z = low[2]; z <= high[2]; ++z) {
        const Range* range = cells.find(x, y, z);
        if (range == nullptr) continue;
        for (std::uint32_t i = range->begin; i < range->end; ++i) {
          const float dx = x_[i] - p[0], dy = y_[i] - p[1], dz = z_[i] - p[2];
          visit(i, dx * dx + dy * dy + dz * dz);
        }
      }
    }
  }
}

}  // namespace segloc
