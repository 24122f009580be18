// Where a query seen from above fits a map seen from above: branch and bound.
#pragma once

#include <cstddef>
#include <cstdint>
#include <limits>
#include <vector>

#include "occupancy/occupancy_pyramid.h"
#include "simd/kernels.h"

namespace segloc {

struct SearchLimits {
  std::size_t yaws = 120;    // headings, evenly over the circle
  int leaf_level = 1;        // windows of so many doublings are not divided
  std::size_t width = 4000;  // branches that are kept at each level
  std::size_t count = 64;    // poses wanted
  double separation = 2.0;   // metres between those of like heading
  double separation_deg = 9.0;
  double x = 0.0, y = 0.0;  // poses are no farther from here than `radius`
  double radius = std::numeric_limits<double>::infinity();
};

struct PlanarPose {
  double x, y, yaw;
  std::uint32_t score;  // columns' slices that the map holds within the leaf's window
};

// Where a sensor may be, in windows of a pyramid's highest level, with that level laid out so that
// neighbouring windows are scored together.
class SearchArea {
 public:
  // Roots: (r, 2), each a window in multiples of its width. Throws std::invalid_argument where they
  // lie too far apart. The pyramid must outlive this.
  SearchArea(const OccupancyPyramid& map, const std::int32_t* roots, std::size_t r, double range);

  // The query: (m, 2) columns in metres about the sensor, no farther than `range`, and the slices
  // that each occupies. Best first. Where `width` is eight times the branches of a level that
  // could still hold one of the best, none is overlooked (up to the step of the heading).
  std::vector<PlanarPose> search(const float* columns, const std::uint8_t* slices, std::size_t m,
                                 const SearchLimits& limits) const;

  // The most that the columns, at these offsets in cells, can reach in each window of each run.
  void score(const std::int32_t* offsets, const std::uint8_t* slices, std::size_t m,
             std::vector<std::uint16_t>& scores) const;

  // Calls visit(its place among the scores, x, y) for each root.
  template <typename Visit>
  void visit(Visit&& visit) const {
    for (std::size_t k = 0; k < runs_.size(); ++k) {
      for (std::int32_t j = 0; j < kSpan; ++j) {
        if (runs_[k].members >> j & 1u) visit(k * kRun + j, runs_[k].x + j, runs_[k].y);
      }
    }
  }

  static constexpr std::size_t kRun = kWindowRun;

  const OccupancyPyramid& map() const { return map_; }
  std::size_t bytes() const {
    std::size_t sum = image_.size();
    for (const auto& level : flat_) sum += level.size();
    return sum;
  }

  // Whether this level and those between it and the highest one are kept as plain images, of which
  // a cell is this one, and a row so wide. Roots and the columns about them lie within.
  bool is_flat(int level) const { return level > 0 && !flat_.empty(); }
  const std::uint8_t* flat(int level, std::int32_t x, std::int32_t y) const {
    const int top = map_.levels() - 1;
    const auto row = static_cast<std::size_t>(y - low_y_ * (1 << top));
    return flat_[static_cast<std::size_t>(level) - 1].data() + row * (wide_ << top) +
           static_cast<std::size_t>(x - low_x_ * (1 << top));
  }
  std::int32_t wide() const { return static_cast<std::int32_t>(wide_) << (map_.levels() - 1); }
  double range() const { return range_; }

 private:
  static constexpr std::int32_t kSpan = kRun;

  struct Run {  // windows side by side, of which those whose bit is set are roots
    std::int32_t x, y;
    std::uint32_t members;
    std::size_t at;  // in each image
  };

  void lay_out();
  void lay_flat();
  std::size_t place_of(std::int32_t x, std::int32_t y) const {
    return static_cast<std::size_t>(y - low_y_) * wide_ + static_cast<std::size_t>(x - low_x_);
  }

  const OccupancyPyramid& map_;
  double range_;
  std::vector<Run> runs_;               // sorted by (y, x)
  std::int32_t low_x_ = 0, low_y_ = 0;  // of the images, in windows
  std::size_t wide_ = 0, high_ = 0;
  std::vector<std::uint8_t> image_;  // one image for each place of a cell within a window
  std::vector<std::vector<std::uint8_t>>
      flat_;  // from the first level to the one below the highest
};

}  // namespace segloc
