#include "proposals/occupancy/occupancy_pyramid.h"

#include <algorithm>
#include <cmath>
#include <stdexcept>
#include <utility>

namespace segloc {
namespace {

constexpr std::size_t kMostTiles = std::size_t{1} << 24;  // of the bounding box
constexpr double kFarthest = 1 << 28;                     // cells from the origin

}  // namespace

OccupancyPyramid::OccupancyPyramid(const float* points, const std::uint8_t* slices, std::size_t n,
                                   double cell, int levels)
    : cell_(cell), levels_(static_cast<std::size_t>(levels)) {
  std::vector<std::int32_t> cells(2 * n);
  for (std::size_t i = 0; i < n; ++i) {
    for (std::size_t a = 0; a < 2; ++a) {
      const double at = std::floor(double(points[3 * i + a]) / cell);
      if (!(std::abs(at) < kFarthest)) throw std::invalid_argument("points lie too far apart");
      cells[2 * i + a] = static_cast<std::int32_t>(at);
    }
  }
  number_tiles(cells);
  levels_[0].assign((tiles_.size() + 1) << (2 * kShift), 0);
  for (std::size_t i = 0; i < n; ++i) {
    const std::int32_t x = cells[2 * i], y = cells[2 * i + 1];
    const auto tx = static_cast<std::uint32_t>((x >> kShift) - tile_x_);
    const auto ty = static_cast<std::uint32_t>((y >> kShift) - tile_y_);
    const std::size_t tile = tile_of_[std::size_t{ty} * tiles_wide_ + tx];
    const auto inside = static_cast<std::size_t>(((y & kMask) << kShift) | (x & kMask));
    levels_[0][(tile << (2 * kShift)) + inside] |= slices[i];
  }
  for (std::size_t level = 1; level < levels_.size(); ++level) widen(level);
}

// Windows begin up to a tile before what is in them: such tiles are kept, too.
void OccupancyPyramid::number_tiles(const std::vector<std::int32_t>& cells) {
  if (cells.empty()) return;
  std::int32_t low[2] = {cells[0], cells[1]}, high[2] = {cells[0], cells[1]};
  for (std::size_t i = 0; i < cells.size(); ++i) {
    low[i % 2] = std::min(low[i % 2], cells[i]);
    high[i % 2] = std::max(high[i % 2], cells[i]);
  }
  tile_x_ = (low[0] >> kShift) - 1;
  tile_y_ = (low[1] >> kShift) - 1;
  tiles_wide_ = static_cast<std::uint32_t>((high[0] >> kShift) - tile_x_ + 1);
  tiles_high_ = static_cast<std::uint32_t>((high[1] >> kShift) - tile_y_ + 1);
  if (std::size_t{tiles_wide_} * tiles_high_ > kMostTiles) {
    throw std::invalid_argument("points lie too far apart");
  }
  tile_of_.assign(std::size_t{tiles_wide_} * tiles_high_, 0);
  for (std::size_t i = 0; i < cells.size(); i += 2) {
    const std::size_t tx = static_cast<std::size_t>((cells[i] >> kShift) - tile_x_);
    const std::size_t ty = static_cast<std::size_t>((cells[i + 1] >> kShift) - tile_y_);
    for (const std::size_t y : {ty - 1, ty}) {
      for (const std::size_t x : {tx - 1, tx}) tile_of_[y * tiles_wide_ + x] = 1;
    }
  }
  for (std::uint32_t k = 0; k < tile_of_.size(); ++k) {
    if (tile_of_[k] == 0) continue;
    tiles_.push_back({tile_x_ + static_cast<std::int32_t>(k % tiles_wide_),
                      tile_y_ + static_cast<std::int32_t>(k / tiles_wide_)});
    tile_of_[k] = static_cast<std::uint32_t>(tiles_.size());
  }
}

void OccupancyPyramid::widen(std::size_t level) {
  const int below = static_cast<int>(level) - 1;
  const std::int32_t half = std::int32_t{1} << below;
  levels_[level].assign((tiles_.size() + 1) << (2 * kShift), 0);
  std::size_t slot = std::size_t{1} << (2 * kShift);
  for (const auto& [tx, ty] : tiles_) {
    for (std::int32_t dy = 0; dy < kSide; ++dy) {
      for (std::int32_t dx = 0; dx < kSide; ++dx, ++slot) {
        const std::int32_t x = tx * kSide + dx, y = ty * kSide + dy;
        levels_[level][slot] =
            static_cast<std::uint8_t>(at(below, x, y) | at(below, x + half, y) |
                                      at(below, x, y + half) | at(below, x + half, y + half));
      }
    }
  }
}

std::size_t OccupancyPyramid::bytes() const {
  std::size_t sum = tile_of_.size() * sizeof(std::uint32_t);
  for (const auto& level : levels_) sum += level.size();
  return sum;
}

}  // namespace segloc
