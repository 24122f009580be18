// Occupancy of a map by cell and height slice, and of ever wider windows.
#pragma once

#include <cstddef>
#include <cstdint>
#include <vector>

namespace segloc {

// Cells are kept in tiles, only where any is occupied. One byte per cell: one bit per height slice.
class OccupancyPyramid {
 public:
  // Cells of `cell` metres and one bit of `slices` for each point of (n, 3), row-major.
  // Level k tells of every cell which slices are occupied in the window of 2^k by 2^k cells that
  // begins there. Throws std::invalid_argument where the points lie too far apart.
  OccupancyPyramid(const float* points, const std::uint8_t* slices, std::size_t n, double cell,
                   int levels);

  std::uint8_t at(int level, std::int32_t x, std::int32_t y) const {
    const auto tx = static_cast<std::uint32_t>((x >> kShift) - tile_x_);
    const auto ty = static_cast<std::uint32_t>((y >> kShift) - tile_y_);
    if (tx >= tiles_wide_ || ty >= tiles_high_) return 0;
    const std::uint32_t tile = tile_of_[std::size_t{ty} * tiles_wide_ + tx];
    const std::size_t inside = ((y & kMask) << kShift) | (x & kMask);
    return levels_[static_cast<std::size_t>(level)][(std::size_t{tile} << (2 * kShift)) + inside];
  }

  double cell() const { return cell_; }
  int levels() const { return static_cast<int>(levels_.size()); }
  std::size_t bytes() const;

 private:
  static constexpr int kShift = 6;
  static constexpr std::int32_t kSide = 1 << kShift, kMask = kSide - 1;

  void number_tiles(const std::vector<std::int32_t>& cells);
  void widen(std::size_t level);

  double cell_;
  std::int32_t tile_x_ = 0, tile_y_ = 0;
  std::uint32_t tiles_wide_ = 0, tiles_high_ = 0;
  std::vector<std::uint32_t> tile_of_;  // of the bounding box; 0: the empty tile
  std::vector<std::pair<std::int32_t, std::int32_t>> tiles_;  // from the first that is not empty
  std::vector<std::vector<std::uint8_t>> levels_;
};

}  // namespace segloc
