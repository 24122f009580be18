#include "segmentation/point_grid.h"

#include <algorithm>
#include <stdexcept>

#include "common/cells.h"

namespace segloc {

// Cells twice as wide as the radius: a neighbourhood touches eight of them at most.
PointGrid::PointGrid(const float* points, std::size_t n, double radius) : cell_(2.0 * radius) {
  const CellOrder cells = sort_into_cells(points, n, cell_);
  points_.resize(n);
  original_.assign(cells.order.begin(), cells.order.end());
  std::size_t occupied = 0;
  for (std::size_t i = 0; i < n; ++i) {
    const float* p = points + 3 * static_cast<std::size_t>(cells.order[i]);
    for (int a = 0; a < 3; ++a) {
      if (std::abs(p[a] / cell_) >= double(kAxis - 2))
        throw std::invalid_argument("cloud too wide");
    }
    points_[i] = {p[0], p[1], p[2]};
    if (i == 0 || cells.keys[i] != cells.keys[i - 1]) ++occupied;
  }
  std::size_t capacity = 16;
  while (capacity < 2 * occupied) capacity *= 2;
  table_.assign(capacity, Slot{0, 0, 0});
  mask_ = capacity - 1;
  for (std::size_t i = 0; i < n;) {
    std::size_t j = i;
    while (j < n && cells.keys[j] == cells.keys[i]) ++j;
    std::int64_t c[3];
    for (int a = 0; a < 3; ++a) c[a] = static_cast<std::int64_t>(std::floor(points_[i][a] / cell_));
    const std::uint64_t k = key(c[0], c[1], c[2]);
    std::size_t slot = hash(k) & mask_;
    while (table_[slot].begin != table_[slot].end) slot = (slot + 1) & mask_;
    table_[slot] = {k, static_cast<std::uint32_t>(i), static_cast<std::uint32_t>(j)};
    i = j;
  }
}

float PointGrid::nearest_squared(const Point& p, float limit) const {
  const double radius = std::sqrt(static_cast<double>(limit)) * (1.0 + 1e-6);
  float best = limit * 2.0f;
  visit(p, radius, [&](std::uint32_t, float squared) { best = std::min(best, squared); });
  return best;
}

}  // namespace segloc
