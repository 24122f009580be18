// A cloud as a surface: its points and their normals.
#pragma once

#include <array>
#include <atomic>
#include <cstddef>
#include <cstdint>
#include <cstdlib>
#include <memory>
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

  struct Nearest {
    std::uint32_t point;  // its place in the grid's order; kNone where none is close enough
    float distance;       // to it
    float next;           // at least as far as this are all others: a bound, not a distance
  };
  static constexpr std::uint32_t kNone = PointGrid::kNone;

  // Copies n points, (n, 3) row-major. Nearest points are those up to `max_correspondence_distance`
  // metres away; the points within `support` metres of one decide on its normal.
  // `rows` receives the row of each in the input.
  Surface(const float* points, std::size_t n, double max_correspondence_distance, double support,
          std::vector<std::uint32_t>* rows = nullptr);

  std::size_t size() const { return grid_.size(); }
  const PointGrid& grid() const { return grid_; }

  Nearest nearest(const PointGrid::Point& p) const;
  // How far a place may move before any point can be close enough, where none is. Metres.
  float room(const PointGrid::Point& p) const;

  // Unit length, of either sign; zero where the points around do not span a plane.
  Normal normal(std::size_t i) const;

 private:
  Normal found(std::size_t i) const;

  PointGrid grid_;
  double max_correspondence_distance_, support_;
  struct Free {
    void operator()(std::atomic<std::uint64_t>* values) const { std::free(values); }
  };
  // Packed; 0: not yet found. Of a large map only the pages around queries take memory.
  std::unique_ptr<std::atomic<std::uint64_t>[], Free> normals_;
};

struct Slope {  // limits of the vertical part of a unit normal
  double least, most;
};

struct OnPlane {
  std::size_t hits, of;
};

// Counts every `step`-th point of a transformed source whose own normal has the given slope and
// whose nearest target point has a normal: all, and those within the tolerance of its plane [m].
OnPlane on_plane(const Surface& target, const Surface& source, const Rigid& T, std::size_t step,
                 const Slope& slope, double tolerance);

}  // namespace segloc
