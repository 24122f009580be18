#include "point_index.h"

#include <algorithm>
#include <cmath>
#include <map>
#include <stdexcept>
#include <utility>

#include "cells.h"

namespace segloc {
namespace {

constexpr double kTile = 20.0;  // metres
constexpr std::int64_t kAxis = std::int64_t{1} << 20;  // cells to either side of the origin

std::uint64_t hash(std::uint64_t key) { return (key * 0x9E3779B97F4A7C15ull) >> 20; }

}  // namespace

std::uint64_t PointIndex::key(std::int64_t x, std::int64_t y, std::int64_t z) const {
  return (static_cast<std::uint64_t>(x + kAxis) << 42) | (static_cast<std::uint64_t>(y + kAxis) << 21) |
         static_cast<std::uint64_t>(z + kAxis);
}

// Cells twice as wide as the radius: a neighbourhood touches eight of them at most.
PointIndex::PointIndex(const float* points, std::size_t n, double radius)
    : reach_(points, n), cell_(2.0 * radius) {
  const CellOrder cells = sort_into_cells(points, n, cell_);
  points_.resize(n);
  original_.assign(cells.order.begin(), cells.order.end());
  std::size_t occupied = 0;
  for (std::size_t i = 0; i < n; ++i) {
    const float* p = points + 3 * static_cast<std::size_t>(cells.order[i]);
    for (int a = 0; a < 3; ++a) {
      if (std::abs(p[a] / cell_) >= double(kAxis - 2)) throw std::invalid_argument("cloud too wide");
    }
    points_[i] = {p[0], p[1], p[2]};
    if (i == 0 || cells.keys[i] != cells.keys[i - 1]) ++occupied;
  }
  std::size_t capacity = 16;
  while (capacity < 2 * occupied) capacity *= 2;
  table_.assign(capacity, Slot{0, 0, 0});
  mask_ = capacity - 1;
  for (std::size_t i = 0; i < n;) {
    std::size_t j = i;
    while (j < n && cells.keys[j] == cells.keys[i]) ++j;
    std::int64_t c[3];
    for (int a = 0; a < 3; ++a) c[a] = static_cast<std::int64_t>(std::floor(points_[i][a] / cell_));
    const std::uint64_t k = key(c[0], c[1], c[2]);
    std::size_t slot = hash(k) & mask_;
    while (table_[slot].begin != table_[slot].end) slot = (slot + 1) & mask_;
    table_[slot] = {k, static_cast<std::uint32_t>(i), static_cast<std::uint32_t>(j)};
    i = j;
  }
  fill_tiles();
}

void PointIndex::fill_tiles() {
  std::map<std::pair<std::int64_t, std::int64_t>, std::vector<std::uint32_t>> tiles;
  for (std::size_t i = 0; i < points_.size(); ++i) {
    const auto x = static_cast<std::int64_t>(std::floor(points_[i][0] / kTile));
    const auto y = static_cast<std::int64_t>(std::floor(points_[i][1] / kTile));
    tiles[{y, x}].push_back(static_cast<std::uint32_t>(i));
  }
  for (auto& [at, points] : tiles) tiles_.push_back({at.first, at.second, std::move(points)});
}

const PointIndex::Slot* PointIndex::find(std::uint64_t k) const {
  for (std::size_t slot = hash(k) & mask_;; slot = (slot + 1) & mask_) {
    if (table_[slot].begin == table_[slot].end) return nullptr;
    if (table_[slot].key == k) return &table_[slot];
  }
}

float PointIndex::nearest_squared(const Point& p, float limit) const {
  const double reach = std::sqrt(static_cast<double>(limit)) * (1.0 + 1e-6);
  std::int64_t low[3], high[3];
  for (int a = 0; a < 3; ++a) {
    if (!(std::abs(p[a] / cell_) < double(kAxis - 2))) return limit * 2.0f;
    low[a] = static_cast<std::int64_t>(std::floor((p[a] - reach) / cell_));
    high[a] = static_cast<std::int64_t>(std::floor((p[a] + reach) / cell_));
  }
  float best = limit * 2.0f;
  for (std::int64_t x = low[0]; x <= high[0]; ++x) {
    for (std::int64_t y = low[1]; y <= high[1]; ++y) {
      for (std::int64_t z = low[2]; z <= high[2]; ++z) {
        const Slot* slot = find(key(x, y, z));
        if (slot == nullptr) continue;
        for (std::uint32_t i = slot->begin; i < slot->end; ++i) {
          const float dx = points_[i][0] - p[0], dy = points_[i][1] - p[1], dz = points_[i][2] - p[2];
          best = std::min(best, dx * dx + dy * dy + dz * dz);
        }
      }
    }
  }
  return best;
}

PointIndex::Overlap PointIndex::overlap(const float* points, std::size_t m, const double* T,
                                        double radius) const {
  Overlap result;
  const auto limit = static_cast<float>(radius * radius);
  for (std::size_t i = 0; i < m; ++i) {
    const float* p = points + 3 * i;
    Point moved;
    for (int a = 0; a < 3; ++a) {
      moved[a] = static_cast<float>(T[4 * a] * p[0] + T[4 * a + 1] * p[1] + T[4 * a + 2] * p[2] + T[4 * a + 3]);
    }
    if (!reach_.contains(moved[0], moved[1], moved[2])) continue;
    ++result.judged;
    const float d2 = nearest_squared(moved, limit);
    if (d2 > limit) continue;
    ++result.near;
    result.squared_sum += d2;
  }
  return result;
}

std::vector<std::int64_t> PointIndex::within(double x, double y, double radius) const {
  std::vector<std::int64_t> found;
  const double r2 = radius * radius;
  // Tiles run fastest along x: each row of tiles is one range of the sorted points.
  const auto low = [](double v) { return static_cast<std::int64_t>(std::floor(v / kTile)); };
  if (!(std::abs(x) + radius < 1e12 && std::abs(y) + radius < 1e12)) return found;
  for (std::int64_t ty = low(y - radius); ty <= low(y + radius); ++ty) {
    auto tile = std::lower_bound(tiles_.begin(), tiles_.end(), std::make_pair(ty, low(x - radius)),
                                 [](const Tile& t, const auto& at) {
                                   return std::make_pair(t.y, t.x) < at;
                                 });
    for (; tile != tiles_.end() && tile->y == ty && tile->x <= low(x + radius); ++tile) {
      for (const std::uint32_t i : tile->points) {
        const double dx = points_[i][0] - x, dy = points_[i][1] - y;
        if (dx * dx + dy * dy <= r2) found.push_back(original_[i]);
      }
    }
  }
  std::sort(found.begin(), found.end());
  return found;
}

}  // namespace segloc
