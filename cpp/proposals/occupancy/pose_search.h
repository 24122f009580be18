// Branch-and-bound search for poses of a query in an occupancy map.
#pragma once

#include <cstddef>
#include <cstdint>
#include <limits>
#include <vector>

#include "proposals/occupancy/occupancy_pyramid.h"
#include "simd/kernels.h"

namespace segloc {

struct SearchLimits {
  std::size_t yaws = 120;    // headings, evenly over the circle
  int leaf_level = 1;        // level of windows that are not divided
  std::size_t width = 4000;  // branches that are kept at each level
  std::size_t count = 64;    // poses wanted
  double separation = 2.0;   // metres between those of like heading
  double separation_deg = 9.0;
  double x = 0.0, y = 0.0;  // poses are no farther from here than `radius`
  double radius = std::numeric_limits<double>::infinity();
};

// Occupancy of a query, in metres around the sensor.
struct PlanarView {
  const float* columns;        // (m, 2): occupied cells,
  const std::uint8_t* slices;  // (m,): and in which slices
  std::size_t m;
  const float* free;              // (f, 2): free cells with ground,
  const std::uint8_t* clearance;  // (f,): clear cells around each; the clearest first
  std::size_t f;
};

struct PlanarPose {
  double x, y, yaw;
  float score;  // see SearchArea::search
};

// Where a sensor may be, in windows of a pyramid's highest level, with that level laid out so that
// neighbouring windows are scored together.
class SearchArea {
 public:
  // Roots: (r, 2), each a window in multiples of its width. Throws std::invalid_argument where they
  // lie too far apart. The pyramid must outlive this.
  SearchArea(const OccupancyPyramid& map, const std::int32_t* roots, std::size_t r, double range);

  // Of a query that shows nothing farther than `range`, best first. The score: how many slices of
  // the columns the map holds within the window, less what free places cost that are blocked, seen
  // from the middle of the window. At each level only such count as are clear to the edges of its
  // windows. Without any, where `width` is eight times the branches of a level that could still
  // hold one of the best, none is overlooked that its widest window holds at the middle of its
  // turn, too.
  std::vector<PlanarPose> search(const PlanarView& view, const SearchLimits& limits) const;

  // The most that the columns, at these offsets in cells, can reach in each window of some runs.
  void score(const std::vector<std::size_t>& runs, const std::int32_t* offsets,
             const std::uint8_t* slices, std::size_t m, std::vector<std::uint16_t>& scores) const {
    add_up(image_, runs, offsets, slices, m, scores);
  }
  // How many of m places, at these offsets in cells, are blocked from the middle of each window.
  void blocked(const std::vector<std::size_t>& runs, const std::int32_t* offsets, std::size_t m,
               std::vector<std::uint16_t>& counts) const {
    add_up(middles_, runs, offsets, nullptr, m, counts);
  }

  // Calls visit(run, place within it, x, y) for each root.
  template <typename Visit>
  void visit(Visit&& visit) const {
    for (std::size_t k = 0; k < runs_.size(); ++k) {
      for (std::int32_t j = 0; j < kSpan; ++j) {
        if (runs_[k].members >> j & 1u) visit(k, std::size_t(j), runs_[k].x + j, runs_[k].y);
      }
    }
  }

  static constexpr std::size_t kRun = kWindowRun;

  const OccupancyPyramid& map() const { return map_; }
  std::size_t bytes() const {
    std::size_t sum = image_.size() + middles_.size();
    for (const auto& level : flat_) sum += level.size();
    return sum;
  }

  // Whether the levels below the highest one are kept as plain images, of which a cell is this one,
  // and a row so wide; of the lowest what blocks. Roots and what is seen about them lie within.
  bool is_flat() const { return !flat_.empty(); }
  const std::uint8_t* flat(int level, std::int32_t x, std::int32_t y) const {
    const int top = map_.levels() - 1;
    const auto row = static_cast<std::size_t>(y - low_y_ * (1 << top));
    return flat_[static_cast<std::size_t>(level)].data() + row * (wide_ << top) +
           static_cast<std::size_t>(x - low_x_ * (1 << top));
  }
  // Whether something stands in a cell, so that its ground is not seen: in the map at least three
  // of the four lowest slices are occupied. Single points may be noise.
  bool is_blocked(std::int32_t x, std::int32_t y) const {
    const std::uint32_t empty = ~std::uint32_t{map_.at(0, x, y)} & 15u;
    return (empty & (empty - 1)) == 0;
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
  // Adds up bits, of the slices of each column or of all.
  void add_up(const std::vector<std::uint8_t>& image, const std::vector<std::size_t>& runs,
              const std::int32_t* offsets, const std::uint8_t* slices, std::size_t m,
              std::vector<std::uint16_t>& sums) const;
  std::size_t place_of(std::int32_t x, std::int32_t y) const {
    return static_cast<std::size_t>(y - low_y_) * wide_ + static_cast<std::size_t>(x - low_x_);
  }

  const OccupancyPyramid& map_;
  double range_;
  std::vector<Run> runs_;               // sorted by (y, x)
  std::int32_t low_x_ = 0, low_y_ = 0;  // of the images, in windows
  std::size_t wide_ = 0, high_ = 0;
  // One image for each place of a cell within a window; of windows, and of whether they are blocked
  // in their middle.
  std::vector<std::uint8_t> image_, middles_;
  std::vector<std::vector<std::uint8_t>> flat_;  // up to the level below the highest
};

}  // namespace segloc
