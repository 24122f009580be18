// Fixed-radius nearest points in a map's cloud, for verification.
#pragma once

#include <cstddef>
#include <cstdint>
#include <vector>

#include "segmentation/point_grid.h"
#include "verification/observed_height.h"

namespace segloc {

class PointIndex {
 public:
  // Copies n points, (n, 3) row-major. Queries take any radius up to `radius`.
  PointIndex(const float* points, std::size_t n, double radius);

  struct Overlap {
    std::size_t judged = 0;    // points no higher than the indexed ones around them
    std::size_t near = 0;      // those with an indexed point within the radius
    double squared_sum = 0;    // of the distances of the latter
    std::size_t unmapped = 0;  // points with no indexed ones around them at any height
  };

  // How well (m, 3) points, taken through a row-major 4 x 4 transform, lie on the indexed ones.
  Overlap overlap(const float* points, std::size_t m, const double* transform, double radius) const;

  // At most `count` of the points within a horizontal distance of (x, y), (k, 3), evenly thinned,
  // in an order of their own.
  std::vector<float> sample(double x, double y, double radius, std::size_t count) const;

  // Calls visit(point) for those within a horizontal distance of (x, y), in the same order.
  template <typename Visit>
  void visit(double x, double y, double radius, Visit&& visit) const {
    for (const std::uint32_t i : within(x, y, radius)) visit(grid_[i]);
  }

  // Whether there are any points around, at any height.
  bool is_mapped(float x, float y) const { return height_.is_mapped(x, y); }

  std::size_t size() const { return grid_.size(); }
  double radius() const { return grid_.radius(); }

 private:
  struct Tile {
    std::int64_t y, x;
    std::vector<std::uint32_t> points;
    std::vector<float> x_of, y_of;  // of those, to be read one after another
  };

  void fill_tiles();
  std::vector<std::uint32_t> within(double x, double y, double radius) const;

  PointGrid grid_;
  ObservedHeight height_;
  std::vector<Tile> tiles_;  // of the plane, sorted by (y, x)
};

}  // namespace segloc
