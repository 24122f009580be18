#include "cluster.h"

#include <algorithm>
#include <cmath>
#include <numeric>

#include "cells.h"

namespace segloc {
namespace {

class DisjointSets {
 public:
  explicit DisjointSets(std::size_t n) : parent_(n) { std::iota(parent_.begin(), parent_.end(), 0u); }

  std::uint32_t find(std::uint32_t i) {
    while (parent_[i] != i) {
      parent_[i] = parent_[parent_[i]];
      i = parent_[i];
    }
    return i;
  }

  // The lower index becomes the root, so roots do not depend on the order of the unions.
  void unite(std::uint32_t a, std::uint32_t b) {
    a = find(a);
    b = find(b);
    if (a != b) parent_[std::max(a, b)] = std::min(a, b);
  }

 private:
  std::vector<std::uint32_t> parent_;
};

struct Cell {
  std::uint64_t key;
  std::uint32_t begin, end;  // range of the sorted points
};

std::vector<Cell> occupied_cells(const CellOrder& sorted) {
  std::vector<Cell> cells;
  const auto n = static_cast<std::uint32_t>(sorted.keys.size());
  for (std::uint32_t i = 0; i < n;) {
    std::uint32_t j = i;
    while (j < n && sorted.keys[j] == sorted.keys[i]) ++j;
    cells.push_back({sorted.keys[i], i, j});
    i = j;
  }
  return cells;
}

bool touch(const std::vector<float>& xyz, const Cell& a, const Cell& b, float radius2) {
  for (std::uint32_t i = a.begin; i < a.end; ++i) {
    for (std::uint32_t j = b.begin; j < b.end; ++j) {
      const float dx = xyz[3 * i] - xyz[3 * j];
      const float dy = xyz[3 * i + 1] - xyz[3 * j + 1];
      const float dz = xyz[3 * i + 2] - xyz[3 * j + 2];
      if (dx * dx + dy * dy + dz * dz <= radius2) return true;
    }
  }
  return false;
}

// Links every cell with the cells of one neighbouring row (fixed dy, dz; dx from -2 to 2). Both the
// cells and their neighbours come in rising key order, so one pass with two pointers does it.
void link_row(const std::vector<Cell>& cells, const std::vector<float>& xyz, std::int64_t shift,
              float radius2, DisjointSets& sets) {
  std::size_t low = 0;
  for (std::size_t c = 0; c < cells.size(); ++c) {
    const std::uint64_t row = cells[c].key + static_cast<std::uint64_t>(shift);
    while (low < cells.size() && cells[low].key + 2 < row) ++low;
    for (std::size_t k = std::max(low, c + 1); k < cells.size() && cells[k].key <= row + 2; ++k) {
      const auto a = static_cast<std::uint32_t>(c), b = static_cast<std::uint32_t>(k);
      if (sets.find(a) != sets.find(b) && touch(xyz, cells[c], cells[k], radius2)) sets.unite(a, b);
    }
  }
}

}  // namespace

Clusters euclidean_clusters(const float* points, std::size_t n, double radius,
                            std::size_t min_points, std::size_t max_points) {
  // Cells with a diagonal just under the radius: two points of one cell are always linked, and a
  // point's neighbours lie at most two cells away.
  const CellOrder sorted = sort_into_cells(points, n, radius / std::sqrt(3.0) * (1.0 - 1e-6));
  const std::vector<Cell> cells = occupied_cells(sorted);
  std::vector<float> xyz(3 * n);
  for (std::size_t i = 0; i < n; ++i) {
    std::copy_n(points + 3 * static_cast<std::size_t>(sorted.order[i]), 3, xyz.begin() + 3 * i);
  }
  DisjointSets sets(cells.size());
  const auto radius2 = static_cast<float>(radius * radius);
  for (std::int64_t dz = 0; dz <= 2; ++dz) {
    for (std::int64_t dy = (dz == 0 ? 0 : -2); dy <= 2; ++dy) {
      link_row(cells, xyz, dy * sorted.stride_y + dz * sorted.stride_z, radius2, sets);
    }
  }

  std::vector<std::uint32_t> size(cells.size(), 0), root_of(n);
  for (std::uint32_t c = 0; c < cells.size(); ++c) {
    const std::uint32_t root = sets.find(c);
    size[root] += cells[c].end - cells[c].begin;
    for (std::uint32_t i = cells[c].begin; i < cells[c].end; ++i) root_of[sorted.order[i]] = root;
  }
  Clusters result;
  result.offsets.push_back(0);
  std::vector<std::int64_t> slot(cells.size(), -1);
  for (std::size_t i = 0; i < n; ++i) {
    const std::uint32_t root = root_of[i];
    if (slot[root] >= 0 || size[root] < min_points || size[root] > max_points) continue;
    slot[root] = result.offsets.back();
    result.offsets.push_back(result.offsets.back() + size[root]);
  }
  result.points.resize(static_cast<std::size_t>(result.offsets.back()));
  for (std::size_t i = 0; i < n; ++i) {
    std::int64_t& next = slot[root_of[i]];
    if (next >= 0) result.points[static_cast<std::size_t>(next++)] = static_cast<std::uint32_t>(i);
  }
  return result;
}

}  // namespace segloc
