#include "segmentation/cluster.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <numeric>

#include "common/cells.h"

namespace segloc {
namespace {

class DisjointSets {
 public:
  explicit DisjointSets(std::size_t n) : parent_(n) {
    std::iota(parent_.begin(), parent_.end(), 0u);
  }

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

// Points that are linked for certain: those in a cube of half the radius.
struct Cell {
  std::uint32_t begin, end;  // range of the sorted points
};

// The up to eight cells in a cube as wide as the radius: whatever a point is linked with lies in
// its own block or in one that touches it.
struct Block {
  std::uint64_t key;
  std::uint32_t begin, end;  // range of the cells
  bool whole;                // all cells are linked
};

class Lattice {
 public:
  Lattice(const float* points, const CellOrder& sorted, double block_size, float radius2)
      : radius2_(radius2), order_(sorted.order), xyz_(3 * sorted.order.size()), sets_(0) {
    const std::size_t n = sorted.keys.size();
    const std::vector<std::uint8_t> octant = octants(points, n, block_size);
    cells_.reserve(n / 2);
    blocks_.reserve(n / 4);
    for (std::size_t i = 0; i < n;) {
      std::size_t j = i;
      while (j < n && sorted.keys[j] == sorted.keys[i]) ++j;
      add_block(points, sorted, octant, i, j);
      i = j;
    }
    sets_ = DisjointSets(cells_.size());
    for (Block& block : blocks_) link_inside(block);
  }

  // Links every block with those next to it along x in the row at some distance. Both come in
  // rising order of their keys, so one pass with two pointers does it.
  void link_row(std::int64_t shift) {
    std::size_t low = 0;
    for (std::size_t b = 0; b < blocks_.size(); ++b) {
      const std::uint64_t row = blocks_[b].key + static_cast<std::uint64_t>(shift);
      while (low < blocks_.size() && blocks_[low].key + 1 < row) ++low;
      std::size_t k = std::max(low, b + 1);
      for (; k < blocks_.size() && blocks_[k].key <= row + 1; ++k) link(blocks_[b], blocks_[k]);
    }
  }

  const std::vector<std::uint32_t>& order() const { return order_; }
  const std::vector<Cell>& cells() const { return cells_; }
  std::uint32_t root(std::size_t cell) { return sets_.find(static_cast<std::uint32_t>(cell)); }

 private:
  // The cell of each point within its block.
  static std::vector<std::uint8_t> octants(const float* points, std::size_t n, double block_size) {
    std::vector<std::uint8_t> octant(n);
    for (std::size_t i = 0; i < n; ++i) {
      unsigned bits = 0;
      for (unsigned a = 0; a < 3; ++a) {
        const double at = points[3 * i + a] / block_size;
        bits |= static_cast<unsigned>(at - std::floor(at) >= 0.5) << a;
      }
      octant[i] = static_cast<std::uint8_t>(bits);
    }
    return octant;
  }

  void add_block(const float* points, const CellOrder& sorted,
                 const std::vector<std::uint8_t>& octant, std::size_t begin, std::size_t end) {
    std::array<std::uint32_t, 9> start{};
    for (std::size_t i = begin; i < end; ++i) ++start[octant[sorted.order[i]] + 1u];
    const auto first_cell = static_cast<std::uint32_t>(cells_.size());
    auto at = static_cast<std::uint32_t>(begin);
    for (std::uint32_t& slot : start) {
      if (slot > 0) cells_.push_back({at, at + slot});
      at += slot;
      slot = at;
    }
    for (std::size_t i = begin; i < end; ++i) {
      const std::uint32_t point = sorted.order[i], slot = start[octant[point]]++;
      order_[slot] = point;
      std::copy_n(points + 3 * static_cast<std::size_t>(point), 3, xyz_.begin() + 3 * slot);
    }
    const auto end_cell = static_cast<std::uint32_t>(cells_.size());
    blocks_.push_back({sorted.keys[begin], first_cell, end_cell, false});
  }

  bool touch(const Cell& a, const Cell& b) const {
    for (std::uint32_t i = a.begin; i < a.end; ++i) {
      for (std::uint32_t j = b.begin; j < b.end; ++j) {
        const float dx = xyz_[3 * i] - xyz_[3 * j];
        const float dy = xyz_[3 * i + 1] - xyz_[3 * j + 1];
        const float dz = xyz_[3 * i + 2] - xyz_[3 * j + 2];
        if (dx * dx + dy * dy + dz * dz <= radius2_) return true;
      }
    }
    return false;
  }

  void link_inside(Block& block) {
    for (std::uint32_t a = block.begin; a < block.end; ++a) {
      for (std::uint32_t b = a + 1; b < block.end; ++b) {
        if (sets_.find(a) != sets_.find(b) && touch(cells_[a], cells_[b])) sets_.unite(a, b);
      }
    }
    block.whole = true;
    for (std::uint32_t a = block.begin; a < block.end; ++a) {
      block.whole &= sets_.find(a) == sets_.find(block.begin);
    }
  }

  void link(const Block& one, const Block& other) {
    const bool whole = one.whole && other.whole;
    if (whole && sets_.find(one.begin) == sets_.find(other.begin)) return;
    for (std::uint32_t a = one.begin; a < one.end; ++a) {
      for (std::uint32_t b = other.begin; b < other.end; ++b) {
        if (!whole && sets_.find(a) == sets_.find(b)) continue;
        if (!touch(cells_[a], cells_[b])) continue;
        sets_.unite(a, b);
        if (whole) return;
      }
    }
  }

  float radius2_;
  std::vector<std::uint32_t> order_;
  std::vector<float> xyz_;
  std::vector<Cell> cells_;
  std::vector<Block> blocks_;
  DisjointSets sets_;
};

}  // namespace

Clusters euclidean_clusters(const float* points, std::size_t n, double radius,
                            std::size_t min_points, std::size_t max_points) {
  // A hair wider than the radius, so that rounding never puts linked points two blocks apart.
  const double block_size = radius * (1.0 + 1e-6);
  const CellOrder sorted = sort_into_cells(points, n, block_size);
  Lattice lattice(points, sorted, block_size, static_cast<float>(radius * radius));
  // Nearest rows first: most blocks of the others are linked by then.
  lattice.link_row(0);
  for (const std::int64_t dz : {0, 1}) {
    for (const std::int64_t dy : {0, 1, -1}) {
      if (dz > 0 || dy > 0) lattice.link_row(dy * sorted.stride_y + dz * sorted.stride_z);
    }
  }

  const std::vector<Cell>& cells = lattice.cells();
  std::vector<std::uint32_t> size(cells.size(), 0), root_of(n);
  for (std::uint32_t c = 0; c < cells.size(); ++c) {
    const std::uint32_t root = lattice.root(c);
    size[root] += cells[c].end - cells[c].begin;
    for (std::uint32_t i = cells[c].begin; i < cells[c].end; ++i) {
      root_of[lattice.order()[i]] = root;
    }
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
