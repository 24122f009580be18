#include "likelihood/point_index.h"

#include <algorithm>
#include <cmath>
#include <map>
#include <utility>

namespace segloc {
namespace {

constexpr double kTile = 20.0;      // metres
constexpr std::size_t kBlock = 32;  // points

std::int64_t tile_of(double v) { return static_cast<std::int64_t>(std::floor(v / kTile)); }

}  // namespace

PointIndex::PointIndex(const float* points, std::size_t n, double radius)
    : grid_(points, n, radius), height_(points, n) {
  fill_tiles();
}

void PointIndex::fill_tiles() {
  std::map<std::pair<std::int64_t, std::int64_t>, std::vector<std::uint32_t>> tiles;
  auto last = tiles.end();  // points come cell by cell: most lie in the tile of the one before
  for (std::size_t i = 0; i < grid_.size(); ++i) {
    const std::pair at{tile_of(grid_[i][1]), tile_of(grid_[i][0])};
    if (last == tiles.end() || last->first != at) last = tiles.try_emplace(at).first;
    last->second.push_back(static_cast<std::uint32_t>(i));
  }
  for (const auto& [at, points] : tiles) {
    const std::size_t begin = points_.size();
    for (const std::uint32_t i : points) {
      points_.push_back(i);
      x_of_.push_back(grid_[i][0]);
      y_of_.push_back(grid_[i][1]);
      z_of_.push_back(grid_[i][2]);
    }
    tiles_.push_back({at.first, at.second, 0, 0});
    fill_blocks(tiles_.back(), begin);
  }
}

void PointIndex::fill_blocks(Tile& tile, std::size_t begin) {
  tile.first_block = blocks_.size();
  for (; begin < points_.size(); begin += kBlock) {
    const std::size_t end = std::min(begin + kBlock, points_.size());
    const auto range = [&](const std::vector<float>& of) {
      return std::minmax_element(of.begin() + static_cast<std::ptrdiff_t>(begin),
                                 of.begin() + static_cast<std::ptrdiff_t>(end));
    };
    const auto [low_x, high_x] = range(x_of_);
    const auto [low_y, high_y] = range(y_of_);
    const auto [low_z, high_z] = range(z_of_);
    blocks_.push_back({begin, end, *low_x, *high_x, *low_y, *high_y, *low_z, *high_z});
  }
  tile.last_block = blocks_.size();
}

PointIndex::Overlap PointIndex::overlap(const float* points, std::size_t m, const double* T,
                                        double radius) const {
  Overlap result;
  const auto limit = static_cast<float>(radius * radius);
  for (std::size_t i = 0; i < m; ++i) {
    const float* p = points + 3 * i;
    PointGrid::Point moved;
    for (int a = 0; a < 3; ++a) {
      moved[a] = static_cast<float>(T[4 * a] * p[0] + T[4 * a + 1] * p[1] + T[4 * a + 2] * p[2] +
                                    T[4 * a + 3]);
    }
    const ObservedHeight::View view = height_.at(moved[0], moved[1], moved[2]);
    result.unmapped += view == ObservedHeight::View::kUnmapped;
    if (view != ObservedHeight::View::kSeen) continue;
    ++result.compared;
    const float d2 = grid_.nearest_squared(moved, limit);
    if (d2 > limit) continue;
    ++result.near;
    result.squared_sum += d2;
  }
  return result;
}

// What the nearest and the farthest place of a block are decides for all in it: no point is rounded
// to be nearer or farther than those.
PointIndex::Part PointIndex::part_of(const Block& block, const Column& column) const {
  const double near_x = std::clamp(column.x, block.low_x, block.high_x);
  const double near_y = std::clamp(column.y, block.low_y, block.high_y);
  const double level = std::clamp(column.low, block.low_z, block.high_z);
  if (!column.holds(near_x, near_y, level)) return {&block, 0};
  const auto farther = [](double at, double low, double high) {
    return std::abs(low - at) > std::abs(high - at) ? low : high;
  };
  const double far_x = farther(column.x, block.low_x, block.high_x);
  const double far_y = farther(column.y, block.low_y, block.high_y);
  if (column.holds(far_x, far_y, block.low_z) && column.holds(far_x, far_y, block.high_z)) {
    return {&block, block.end - block.begin};
  }
  std::size_t count = 0;
  for (std::size_t k = block.begin; k < block.end; ++k) {
    count += column.holds(x_of_[k], y_of_[k], z_of_[k]);
  }
  return {&block, count};
}

std::vector<PointIndex::Part> PointIndex::parts(const Column& column) const {
  std::vector<Part> found;
  const double x = column.x, y = column.y, radius = column.radius;
  if (!(std::abs(x) + radius < 1e12 && std::abs(y) + radius < 1e12)) return found;
  const std::int64_t first = tile_of(x - radius), last = tile_of(x + radius);
  const std::int64_t bottom = tile_of(y - radius), top = tile_of(y + radius);
  const auto next = [&](auto from, std::int64_t row) {
    return std::lower_bound(
        from, tiles_.end(), std::make_pair(row, first),
        [](const Tile& t, const auto& at) { return std::make_pair(t.y, t.x) < at; });
  };
  // Tiles run fastest along x: each row of tiles is one range of the sorted ones. Rows without any
  // are skipped.
  for (auto tile = next(tiles_.begin(), bottom); tile != tiles_.end() && tile->y <= top;) {
    if (tile->x < first || tile->x > last) {
      tile = next(tile, tile->x < first ? tile->y : tile->y + 1);
      continue;
    }
    for (std::size_t k = tile->first_block; k < tile->last_block; ++k) {
      const Part part = part_of(blocks_[k], column);
      if (part.count > 0) found.push_back(part);
    }
    ++tile;
  }
  return found;
}

std::vector<float> PointIndex::sample(const Column& column, std::size_t count) const {
  const std::vector<Part> found = parts(column);
  std::size_t all = 0;
  for (const Part& part : found) all += part.count;
  if (all == 0) return {};
  const std::size_t step = (all - 1) / std::max<std::size_t>(1, count) + 1;
  std::vector<float> points;
  each(found, column, step, [&](std::uint32_t i) {
    const PointGrid::Point p = grid_[i];
    points.insert(points.end(), p.begin(), p.end());
  });
  return points;
}

}  // namespace segloc
