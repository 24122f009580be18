// Fixed-radius nearest points in a map's cloud, for verification.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <vector>

#include "reach.h"

namespace segloc {

class PointIndex {
 public:
  // Copies n points, (n, 3) row-major. Queries may ask for any radius up to `radius`.
  PointIndex(const float* points, std::size_t n, double radius);

  using Point = std::array<float, 3>;

  struct Overlap {
    std::size_t judged = 0;  // points no higher than the indexed ones reach around them
    std::size_t near = 0;    // those with an indexed point within the radius
    double squared_sum = 0;  // of the distances of the latter
  };

  // How well (m, 3) points, taken through a row-major 4 x 4 transform, lie on the indexed ones.
  Overlap overlap(const float* points, std::size_t m, const double* transform, double radius) const;

  // Squared distance to the nearest indexed point, or more than the limit where none is within it.
  // The root of the limit is at most the radius.
  float nearest_squared(const Point& p, float limit) const;

  // Indices, rising, of the points within a horizontal distance of (x, y).
  std::vector<std::int64_t> within(double x, double y, double radius) const;

  std::size_t size() const { return points_.size(); }
  double radius() const { return cell_ / 2; }

 private:
  struct Slot {
    std::uint64_t key;
    std::uint32_t begin, end;
  };
  struct Tile {
    std::int64_t y, x;
    std::vector<std::uint32_t> points;
  };

  std::uint64_t key(std::int64_t x, std::int64_t y, std::int64_t z) const;
  const Slot* find(std::uint64_t key) const;
  void fill_tiles();

  Reach reach_;
  double cell_;
  std::vector<Point> points_;
  std::vector<std::uint32_t> original_;
  std::vector<Slot> table_;  // open addressing; a slot with begin == end is free
  std::size_t mask_ = 0;
  std::vector<Tile> tiles_;  // of the plane, sorted by (y, x)
};

}  // namespace segloc
