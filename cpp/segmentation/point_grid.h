// Points in a hashed grid: what lies near a place, in clouds of any extent.
#pragma once

#include <array>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <vector>

namespace segloc {

class PointGrid {
 public:
  using Point = std::array<float, 3>;

  // Copies n points, (n, 3) row-major, and sorts them by cell. Queries take any radius up to
  // `radius`. Throws std::invalid_argument where the points lie too far apart for that radius.
  PointGrid(const float* points, std::size_t n, double radius);

  std::size_t size() const { return points_.size(); }
  double radius() const { return cell_ / 2; }
  const Point& operator[](std::size_t i) const { return points_[i]; }  // in the grid's own order
  std::size_t original(std::size_t i) const { return original_[i]; }   // its row in the input

  // Calls visit(i, squared distance) for points around p: all those within `radius`, and others.
  template <typename Visit>
  void visit(const Point& p, double radius, Visit&& visit) const;

  // Squared distance to the nearest point, or more than the limit where none is within it.
  float nearest_squared(const Point& p, float limit) const;

 private:
  // Cells of either side of the origin.
  static constexpr std::int64_t kAxis = std::int64_t{1} << 20;

  struct Slot {
    std::uint64_t key;
    std::uint32_t begin, end;
  };

  static std::uint64_t key(std::int64_t x, std::int64_t y, std::int64_t z) {
    return (static_cast<std::uint64_t>(x + kAxis) << 42) |
           (static_cast<std::uint64_t>(y + kAxis) << 21) | static_cast<std::uint64_t>(z + kAxis);
  }
  static std::uint64_t hash(std::uint64_t key) { return (key * 0x9E3779B97F4A7C15ull) >> 20; }
  const Slot* find(std::uint64_t k) const {
    for (std::size_t slot = hash(k) & mask_;; slot = (slot + 1) & mask_) {
      if (table_[slot].begin == table_[slot].end) return nullptr;
      if (table_[slot].key == k) return &table_[slot];
    }
  }

  double cell_;
  std::vector<Point> points_;
  std::vector<std::uint32_t> original_;
  std::vector<Slot> table_;  // open addressing; a slot with begin == end is free
  std::size_t mask_ = 0;
};

template <typename Visit>
void PointGrid::visit(const Point& p, double radius, Visit&& visit) const {
  std::int64_t low[3], high[3];
  for (int a = 0; a < 3; ++a) {
    if (!(std::abs(p[a] / cell_) < double(kAxis - 2))) return;
    low[a] = static_cast<std::int64_t>(std::floor((p[a] - radius) / cell_));
    high[a] = static_cast<std::int64_t>(std::floor((p[a] + radius) / cell_));
  }
  for (std::int64_t x = low[0]; x <= high[0]; ++x) {
    for (std::int64_t y = low[1]; y <= high[1]; ++y) {
      for (std::int64_t z = low[2]; z <= high[2]; ++z) {
        const Slot* slot = find(key(x, y, z));
        if (slot == nullptr) continue;
        for (std::uint32_t i = slot->begin; i < slot->end; ++i) {
          const Point& q = points_[i];
          const float dx = q[0] - p[0], dy = q[1] - p[1], dz = q[2] - p[2];
          visit(i, dx * dx + dy * dy + dz * dz);
        }
      }
    }
  }
}

}  // namespace segloc
