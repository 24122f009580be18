// Fixed-radius nearest points in a map's cloud, for verification.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <limits>
#include <utility>
#include <vector>

#include "frontend/point_grid.h"
#include "likelihood/observed_height.h"

namespace segloc {

class PointIndex {
 public:
  // Copies n points, (n, 3) row-major. Queries take any radius up to `radius`.
  PointIndex(const float* points, std::size_t n, double radius);

  struct Overlap {
    std::size_t compared = 0;    // compared points: no higher than the indexed ones around them
    std::size_t near = 0;      // those with an indexed point within the radius
    double squared_sum = 0;    // of the distances of the latter
    std::size_t unmapped = 0;  // points with no indexed ones around them at any height
  };

  // Overlap of (m, 3) points, transformed by a row-major 4 x 4 matrix, with the indexed ones. To
  // measure the distances takes longer; otherwise they are only within the radius.
  Overlap overlap(const float* points, std::size_t m, const double* transform, double radius,
                  bool measure) const;

  // What is between two heights, within a horizontal distance of (x, y).
  struct Column {
    double x, y, radius;
    double low = -std::numeric_limits<double>::infinity();
    double high = std::numeric_limits<double>::infinity();
    bool holds(double px, double py, double pz) const {
      const double dx = px - x, dy = py - y;
      return dx * dx + dy * dy <= radius * radius && low <= pz && pz <= high;
    }
  };

  // At most `count` of the points in a column, (k, 3), evenly thinned, in an order of their own.
  std::vector<float> sample(const Column& column, std::size_t count) const;

  // Calls visit(point) for those within a horizontal distance of (x, y), in the same order.
  template <typename Visit>
  void visit(double x, double y, double radius, Visit&& visit) const {
    const Column column{x, y, radius};
    each(parts(column), column, 1, visit);
  }

  static constexpr std::uint32_t kBlock = 32;
  // Calls visit(xyz, count) for runs of up to kBlock points, of three arrays, which together are
  // those within a horizontal distance and others beside them.
  template <typename Visit>
  void visit_about(double x, double y, double radius, Visit&& visit) const {
    const Column column{x, y, radius};
    const GridCells cells = grid_.cells();
    each_block(column, [&](const Block& block) {
      if (!reaches(block, column)) return;
      const float* const xyz[3] = {cells.x + block.begin, cells.y + block.begin,
                                   cells.z + block.begin};
      visit(xyz, std::size_t{block.end - block.begin});
    });
  }

  // Which places, x, y, z each, have a point within a radius, no larger than that of the index.
  std::vector<bool> is_near(const std::vector<float>& places, double radius) const;
  // Whether there are any points around, at any height.
  bool is_mapped(float x, float y) const { return height_.is_mapped(x, y); }

  std::size_t size() const { return grid_.size(); }
  double radius() const { return grid_.radius(); }

 private:
  // Points of a tile that follow one another, and where they lie.
  struct Block {
    std::uint32_t begin, end;
    float low[3], high[3];
  };
  struct Tile {
    std::int64_t y, x;
    std::uint32_t first_block, last_block;
  };
  // A block and its number of points in a column.
  struct Part {
    const Block* block;
    std::size_t count;
    bool is_whole() const { return count == block->end - block->begin; }
  };

  static constexpr double kSlack = 1e-6;  // share of a tile by which rounding may move a point

  std::int64_t tile_of(double v) const { return floor_of(v / tile_); }
  void fill_tiles();
  void fill_blocks(Tile& tile, std::uint32_t begin, std::uint32_t end);
  // Whether some place in the bounds of a block is in a column; how many of its points are.
  static bool reaches(const Block& block, const Column& column);
  std::size_t count_in(const Block& block, const Column& column) const;
  // Those of which any do, in order.
  std::vector<Part> parts(const Column& column) const;
  // Calls take(block) for those of the tiles that a column touches, in order.
  template <typename Take>
  void each_block(const Column& column, const Take& take) const {
    const double x = column.x, y = column.y, radius = column.radius;
    if (!(std::abs(x) + radius < 1e12 && std::abs(y) + radius < 1e12)) return;
    const double wide = radius + kSlack * tile_;
    const std::int64_t first = tile_of(x - wide), last = tile_of(x + wide);
    const std::int64_t bottom = tile_of(y - wide), top = tile_of(y + wide);
    const auto next = [&](auto from, std::int64_t row) {
      return std::lower_bound(
          from, tiles_.end(), std::make_pair(row, first),
          [](const Tile& t, const auto& at) { return std::make_pair(t.y, t.x) < at; });
    };
    // Tiles run fastest along x: each row of tiles is one range of the sorted ones. Rows without
    // any are skipped.
    for (auto tile = next(tiles_.begin(), bottom); tile != tiles_.end() && tile->y <= top;) {
      if (tile->x < first || tile->x > last) {
        tile = next(tile, tile->x < first ? tile->y : tile->y + 1);
        continue;
      }
      for (std::size_t k = tile->first_block; k < tile->last_block; ++k) take(blocks_[k]);
      ++tile;
    }
  }
  // Calls take(point) for every step-th of the points in a column, in the grid's order.
  template <typename Take>
  void each(const std::vector<Part>& parts, const Column& column, std::size_t step,
            const Take& take) const {
    std::size_t skip = 0;  // before the next one that is taken
    for (const Part& part : parts) {
      if (skip >= part.count) {
        skip -= part.count;
        continue;
      }
      if (part.is_whole()) {
        for (; skip < part.count; skip += step) take(grid_[part.block->begin + skip]);
        skip -= part.count;
        continue;
      }
      for (std::size_t k = part.block->begin; k < part.block->end; ++k) {
        const PointGrid::Point p = grid_[k];
        if (!column.holds(p[0], p[1], p[2])) continue;
        if (skip > 0) {
          --skip;
          continue;
        }
        take(p);
        skip = step - 1;
      }
    }
  }

  double tile_;     // metres, whole cells of the grid
  PointGrid grid_;  // one tile after another
  ObservedHeight height_;
  std::vector<Tile> tiles_;  // of the plane, sorted by (y, x)
  std::vector<Block> blocks_;
};

}  // namespace segloc
