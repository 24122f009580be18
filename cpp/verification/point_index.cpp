#include "verification/point_index.h"

#include <algorithm>
#include <cmath>
#include <map>
#include <utility>

namespace segloc {
namespace {

constexpr double kTile = 20.0;  // metres

std::int64_t tile_of(double v) { return static_cast<std::int64_t>(std::floor(v / kTile)); }

}  // namespace

PointIndex::PointIndex(const float* points, std::size_t n, double radius)
    : grid_(points, n, radius), height_(points, n) {
  fill_tiles();
}

void PointIndex::fill_tiles() {
  std::map<std::pair<std::int64_t, std::int64_t>, std::vector<std::uint32_t>> tiles;
  for (std::size_t i = 0; i < grid_.size(); ++i) {
    tiles[{tile_of(grid_[i][1]), tile_of(grid_[i][0])}].push_back(static_cast<std::uint32_t>(i));
  }
  for (auto& [at, points] : tiles) {
    tiles_.push_back({at.first, at.second, std::move(points), {}, {}});
    for (const std::uint32_t i : tiles_.back().points) {
      tiles_.back().x_of.push_back(grid_[i][0]);
      tiles_.back().y_of.push_back(grid_[i][1]);
    }
  }
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
    ++result.judged;
    const float d2 = grid_.nearest_squared(moved, limit);
    if (d2 > limit) continue;
    ++result.near;
    result.squared_sum += d2;
  }
  return result;
}

std::vector<std::uint32_t> PointIndex::within(double x, double y, double radius) const {
  std::vector<std::uint32_t> found;
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
    // Without branches: every other point of a tile at the rim is inside.
    const std::size_t before = found.size(), count = tile->points.size();
    found.resize(before + count);
    std::uint32_t* last_found = found.data() + before;
    for (std::size_t k = 0; k < count; ++k) {
      const double dx = tile->x_of[k] - x, dy = tile->y_of[k] - y;
      *last_found = tile->points[k];
      last_found += dx * dx + dy * dy <= radius * radius;
    }
    found.resize(static_cast<std::size_t>(last_found - found.data()));
    ++tile;
  }
  return found;
}

std::vector<float> PointIndex::sample(double x, double y, double radius, std::size_t count) const {
  const std::vector<std::uint32_t> found = within(x, y, radius);
  if (found.empty()) return {};
  const std::size_t step = (found.size() - 1) / std::max<std::size_t>(1, count) + 1;
  std::vector<float> points;
  for (std::size_t k = 0; k < found.size(); k += step) {
    points.insert(points.end(), grid_[found[k]].begin(), grid_[found[k]].end());
  }
  return points;
}

}  // namespace segloc
