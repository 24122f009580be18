#include "frontend/point_grid.h"

#include <algorithm>
#include <cmath>
#include <stdexcept>

#include "common/portability.h"
#include "simd/kernels.h"

namespace segloc {

// Cells twice as wide as the radius: a neighbourhood touches eight of them at most.
PointGrid::PointGrid(const float* points, std::size_t n, double radius, std::int64_t tile_cells,
                     std::vector<std::uint32_t>* rows)
    : cell_(2.0 * radius), per_metre_(1.0 / cell_) {
  CellRuns sorted = sort_into_runs(points, n, cell_);
  if (tile_cells > 0) sort_by_tile(sorted, points, static_cast<double>(tile_cells) * cell_);
  for (std::vector<float>* each : {&x_, &y_, &z_}) each->resize(n + kPad, kInfinity);
  if (rows) rows->resize(n);
  std::vector<GridRange> found;
  std::uint32_t row = 0;
  const auto too_far = static_cast<float>(cell_ * double(kGridAxis - 2));
  bool wide = false;
  for (std::size_t k = 0; k < sorted.runs.size(); ++k) {
    const CellRun& run = sorted.runs[k];
    if (k == 0 || run.key != sorted.runs[k - 1].key) found.push_back({row, row});
    for (std::uint32_t i = run.begin; i < run.end; ++i, ++row) {
      const float* p = points + 3 * static_cast<std::size_t>(i);
      for (int a = 0; a < 3; ++a) wide |= std::abs(p[a]) >= too_far;
      x_[row] = p[0], y_[row] = p[1], z_[row] = p[2];
      if (rows) (*rows)[row] = i;
    }
    found.back().end = row;
  }
  if (wide) throw std::invalid_argument("cloud too wide");
  fill(found);
}

void PointGrid::sort_by_tile(CellRuns& sorted, const float* points, double tile) {
  struct Group {  // of the runs of a cell
    std::int64_t y, x;
    std::size_t begin, end;
  };
  std::vector<Group> groups;
  for (std::size_t k = 0; k < sorted.runs.size(); ++k) {
    const CellRun& run = sorted.runs[k];
    if (k == 0 || run.key != sorted.runs[k - 1].key) {
      const float* p = points + 3 * static_cast<std::size_t>(run.begin);
      groups.push_back({floor_of(p[1] / tile), floor_of(p[0] / tile), k, k});
    }
    groups.back().end = k + 1;
  }
  std::stable_sort(groups.begin(), groups.end(), [](const Group& a, const Group& b) {
    return a.y != b.y ? a.y < b.y : a.x < b.x;
  });
  std::vector<CellRun> runs;
  runs.reserve(sorted.runs.size());
  for (const Group& group : groups) {
    for (std::size_t k = group.begin; k < group.end; ++k) runs.push_back(sorted.runs[k]);
  }
  sorted.runs.swap(runs);
}

void PointGrid::fill(const std::vector<GridRange>& found) {
  std::vector<std::uint64_t> blocks, bits;  // of each cell
  for (const GridRange& range : found) {
    std::int64_t c[3];
    const Point p = (*this)[range.begin];
    for (int a = 0; a < 3; ++a) c[a] = floor_of(p[a] / cell_);
    blocks.push_back(grid_key(c[0] >> kBlockShift, c[1] >> kBlockShift, c[2] >> kBlockShift));
    bits.push_back(grid_bit(c[0], c[1], c[2]));
  }
  std::vector<std::uint64_t> distinct = blocks;
  std::sort(distinct.begin(), distinct.end());
  const auto count = std::unique(distinct.begin(), distinct.end()) - distinct.begin();
  while (std::ptrdiff_t{1} << bits_ < 2 * count) ++bits_;
  table_.assign(std::size_t{1} << bits_, GridBlock{0, 0, 0});
  for (std::size_t i = 0; i < found.size(); ++i) {
    GridBlock& block = table_[grid_slot(table_.data(), bits_, blocks[i])];
    block.key = blocks[i];
    block.cells |= bits[i];
  }
  std::uint32_t first = 0;
  for (GridBlock& block : table_) {
    block.first = first;
    first += static_cast<std::uint32_t>(ones(block.cells));
  }
  ranges_.resize(found.size());
  for (std::size_t i = 0; i < found.size(); ++i) {
    const GridBlock& block = table_[grid_slot(table_.data(), bits_, blocks[i])];
    ranges_[block.first + ones(block.cells & (bits[i] - 1))] = found[i];
  }
}

void PointGrid::sums_within(const float* places, std::size_t count, float distance2,
                            PointSums* sums) const {
  best_kernels().sums_within(cells(), places, count, distance2, sums);
}

void PointGrid::nearest_squared(const float* places, std::size_t count, float limit, float enough,
                                float* squared) const {
  best_kernels().nearest_squared(cells(), places, count, limit, enough, squared);
}

void PointGrid::nearest(const float* places, std::size_t count, float limit, float lead,
                        GridNearest* found) const {
  best_kernels().nearest_points(cells(), places, count, limit, lead, found);
}

}  // namespace segloc
