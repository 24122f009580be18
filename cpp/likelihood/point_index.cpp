#include "likelihood/point_index.h"

#include <algorithm>
#include <cmath>
#include <utility>

#include "common/rigid.h"

namespace segloc {
namespace {

constexpr double kTile = 20.0;      // metres, about

std::int64_t cells_of_tile(double radius) {
  return std::max<std::int64_t>(1, std::llround(kTile / (2.0 * radius)));
}

}  // namespace

PointIndex::PointIndex(const float* points, std::size_t n, double radius)
    : tile_(static_cast<double>(cells_of_tile(radius)) * 2.0 * radius),
      grid_(points, n, radius, cells_of_tile(radius)),
      height_(points, n) {
  fill_tiles();
}

void PointIndex::fill_tiles() {
  const auto n = static_cast<std::uint32_t>(grid_.size());
  blocks_.reserve(n / kBlock);
  const auto place = [&](std::uint32_t i) {
    const PointGrid::Point p = grid_[i];
    return std::pair{tile_of(p[1]), tile_of(p[0])};
  };
  for (std::uint32_t begin = 0, end = 0; begin < n; begin = end) {
    const auto at = place(begin);
    while (end < n && place(end) == at) ++end;
    tiles_.push_back({at.first, at.second, 0, 0});
    fill_blocks(tiles_.back(), begin, end);
  }
}

void PointIndex::fill_blocks(Tile& tile, std::uint32_t begin, std::uint32_t last) {
  tile.first_block = static_cast<std::uint32_t>(blocks_.size());
  for (; begin < last; begin += kBlock) {
    const PointGrid::Point first = grid_[begin];
    Block block{begin, std::min(begin + kBlock, last), {}, {}};
    std::copy(first.begin(), first.end(), block.low);
    std::copy(first.begin(), first.end(), block.high);
    for (std::uint32_t i = begin; i < block.end; ++i) {
      const PointGrid::Point p = grid_[i];
      for (int a = 0; a < 3; ++a) {
        block.low[a] = std::min(block.low[a], p[a]);
        block.high[a] = std::max(block.high[a], p[a]);
      }
    }
    blocks_.push_back(block);
  }
  tile.last_block = static_cast<std::uint32_t>(blocks_.size());
}

PointIndex::Overlap PointIndex::overlap(const float* points, std::size_t m, const double* T,
                                        double radius, bool measure) const {
  Overlap result;
  std::vector<float> places = moved_by(T, points, m);
  for (std::size_t i = 0; i < 3 * m; i += 3) height_.fetch(places[i], places[i + 1]);
  for (std::size_t i = 0; i < m; ++i) {
    const float* p = &places[3 * i];
    const ObservedHeight::View view = height_.at(p[0], p[1], p[2]);
    result.unmapped += view == ObservedHeight::View::kUnmapped;
    if (view == ObservedHeight::View::kSeen) std::copy_n(p, 3, &places[3 * result.compared++]);
  }
  const auto limit = static_cast<float>(radius * radius);
  std::vector<float> squared(result.compared);
  grid_.nearest_squared(places.data(), squared.size(), limit, measure ? -1.0f : limit,
                        squared.data());
  for (const float d2 : squared) {
    if (d2 > limit) continue;
    ++result.near;
    result.squared_sum += d2;
  }
  return result;
}

std::vector<bool> PointIndex::is_near(const std::vector<float>& places, double radius) const {
  const auto limit = static_cast<float>(radius * radius);
  std::vector<float> squared(places.size() / 3);
  grid_.nearest_squared(places.data(), squared.size(), limit, limit, squared.data());
  std::vector<bool> near(squared.size());
  for (std::size_t i = 0; i < squared.size(); ++i) near[i] = squared[i] <= limit;
  return near;
}

bool PointIndex::reaches(const Block& block, const Column& column) {
  const auto nearer = [&](double at, int axis) {
    return std::clamp<double>(at, block.low[axis], block.high[axis]);
  };
  return column.holds(nearer(column.x, 0), nearer(column.y, 1), nearer(column.low, 2));
}

// What the nearest and the farthest place of a block are decides for all in it: no point is rounded
// to be nearer or farther than those.
std::size_t PointIndex::count_in(const Block& block, const Column& column) const {
  if (!reaches(block, column)) return 0;
  const auto farther = [&](double at, int axis) {
    const double low = block.low[axis], high = block.high[axis];
    return std::abs(low - at) > std::abs(high - at) ? low : high;
  };
  const double far_x = farther(column.x, 0), far_y = farther(column.y, 1);
  if (column.holds(far_x, far_y, block.low[2]) && column.holds(far_x, far_y, block.high[2])) {
    return block.end - block.begin;
  }
  std::size_t count = 0;
  for (std::uint32_t k = block.begin; k < block.end; ++k) {
    const PointGrid::Point p = grid_[k];
    count += column.holds(p[0], p[1], p[2]);
  }
  return count;
}

std::vector<PointIndex::Part> PointIndex::parts(const Column& column) const {
  std::vector<Part> found;
  each_block(column, [&](const Block& block) {
    const std::size_t count = count_in(block, column);
    if (count > 0) found.push_back({&block, count});
  });
  return found;
}

std::vector<float> PointIndex::sample(const Column& column, std::size_t count) const {
  const std::vector<Part> found = parts(column);
  std::size_t all = 0;
  for (const Part& part : found) all += part.count;
  if (all == 0) return {};
  const std::size_t step = (all - 1) / std::max<std::size_t>(1, count) + 1;
  std::vector<float> points;
  each(found, column, step,
       [&](const PointGrid::Point& p) { points.insert(points.end(), p.begin(), p.end()); });
  return points;
}

}  // namespace segloc
