// A cloud as a surface: its points and their normals.
#pragma once

#include <array>
#include <atomic>
#include <cstddef>
#include <cstdint>
#include <vector>

#include "common/rigid.h"
#include "frontend/point_grid.h"

namespace segloc {

// A normal takes longer to find than a point, and an alignment needs few of a large map: each is
// computed on first use, and cached. It depends on the points alone, so the order of calls does not
// matter, and several threads may call at once.
class Surface {
 public:
  using Normal = std::array<double, 3>;

  // Copies n points, (n, 3) row-major. Nearest points are those up to `max_correspondence_distance`
  // metres away; the points within `support` metres of one decide on its normal. `tiled`: for
  // targets, points of a tile of the plane follow one another, so that queries in a part of a map
  // need the normals of few blocks. `rows` receives the row of each in the input.
  Surface(const float* points, std::size_t n, double max_correspondence_distance, double support,
          bool tiled = false, std::vector<std::uint32_t>* rows = nullptr);

  std::size_t size() const { return grid_.size(); }
  const PointGrid& grid() const { return grid_; }
  double max_correspondence_distance() const { return max_correspondence_distance_; }

  // The nearest points to places, x, y, z each, in the grid's order. `lead`: PointGrid's, metres.
  std::vector<GridNearest> nearest(const std::vector<float>& places, double lead = 0.0) const;

  // Normals of points by their places in the grid's order. Unit length, of either sign; zero where
  // the points around do not span a plane.
  std::vector<Normal> normals(const std::vector<std::uint32_t>& points) const;

 private:
  PointGrid grid_;
  double max_correspondence_distance_, support_;
  // Packed normals of points that follow one another; 0: not yet found.
  static constexpr std::size_t kBlock = 256;
  using Block = std::array<std::atomic<std::uint64_t>, kBlock>;
  // Blocks are allocated when one of their normals is first requested.
  class Blocks {
   public:
    explicit Blocks(std::size_t points) : blocks_((points + kBlock - 1) / kBlock) {}
    Blocks(const Blocks&) = delete;
    Blocks& operator=(const Blocks&) = delete;
    ~Blocks() {
      for (const std::atomic<Block*>& block : blocks_) delete block.load();
    }
    std::atomic<std::uint64_t>& operator[](std::size_t i);

   private:
    std::vector<std::atomic<Block*>> blocks_;
  };
  mutable Blocks normals_;
};

struct Slope {  // limits of the vertical part of a unit normal
  double least, most;
};

// Every `step`-th point, by its place in the grid's order.
std::vector<std::uint32_t> every(const Surface& surface, std::size_t step);

// Distances [m] of every `step`-th point of a transformed source from the plane of the nearest
// target point: infinite where none with a normal is near, NaN if its own normal has another slope.
std::vector<float> off_plane(const Surface& target, const Surface& source, const Rigid& T,
                             std::size_t step, const Slope& slope);

}  // namespace segloc
