#include "frontend/cluster.h"

#include <algorithm>
#include <functional>
#include <memory>
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
  std::uint32_t unite(std::uint32_t a, std::uint32_t b) {
    a = find(a);
    b = find(b);
    return parent_[std::max(a, b)] = std::min(a, b);
  }

 private:
  std::vector<std::uint32_t> parent_;
};

// Memory that is written before it is read.
template <typename T>
using Raw = std::unique_ptr<T[]>;
template <typename T>
Raw<T> raw(std::size_t size) {
  return Raw<T>(new T[size]);
}

// The points above the lowest of the cuts, which are these rows of the input. Their levels: how many
// of the cuts, which fall, they are not above.
struct Above {
  Above(const float* all, const float* heights, std::size_t n, const std::vector<double>& falling)
      : rows(raw<std::uint32_t>(n)), level(raw<std::uint8_t>(n)), points(raw<float>(3 * n)) {
    for (std::size_t i = 0; i < n; ++i) {  // what is not kept is written over by the next one
      std::size_t below = 0;
      for (const double cut : falling) below += !(heights[i] > cut);
      rows[count] = static_cast<std::uint32_t>(i);
      level[count] = static_cast<std::uint8_t>(below);
      for (std::size_t a = 0; a < 3; ++a) points[3 * count + a] = all[3 * i + a];
      count += below < falling.size();
    }
  }

  std::size_t count = 0;
  Raw<std::uint32_t> rows;
  Raw<std::uint8_t> level;
  Raw<float> points;
};

// Points that are always linked: those in a cube of half the radius. The highest level comes first.
struct Cell {
  std::uint32_t begin;  // of the sorted points
};

// Up to eight cells in a cube as wide as the radius: linked points lie in the same block or in
// adjacent ones.
struct Block {
  std::uint64_t key;
  std::uint32_t begin, end;  // range of the cells
  bool whole;                // all cells have points, and all are linked
  bool grown;                // it has points that are of the level, and of none before it
};

// Points in cells, of which those of ever more levels are linked.
class Lattice {
 public:
  Lattice(const Above& above, std::size_t levels, double radius)
      : levels_(levels), radius2_(static_cast<float>(radius * radius)), sets_(0) {
    const float* points = above.points.get();
    const std::size_t n = above.count;
    // A hair wider than the radius, so that rounding never puts linked points two blocks apart.
    const double block_size = radius * (1.0 + 1e-6);
    const CellRuns sorted = sort_into_runs(points, n, block_size);
    stride_y_ = sorted.stride_y;
    stride_z_ = sorted.stride_z;
    order_ = raw<std::uint32_t>(n), cell_of_ = raw<std::uint32_t>(n), xyz_ = raw<float>(3 * n);
    ends_.reserve(levels * n / 2);
    blocks_.reserve(n / 4);
    const Raw<std::uint16_t> slots = slots_of(above, block_size);
    const CellRun* end = sorted.runs.data() + sorted.runs.size();
    std::uint32_t row = 0;
    for (const CellRun* begin = sorted.runs.data(); begin < end;) {
      const CellRun* next = begin;
      while (next < end && next->key == begin->key) ++next;
      row = add_block(points, begin, next, slots, row);
      begin = next;
    }
    sets_ = DisjointSets(cells_.size());
  }

  // Links the points of one more level with each other and with those of the levels before it.
  void link_level(std::size_t level) {
    level_ = level;
    for (Block& block : blocks_) link_inside(block);
    // Nearest rows first: most blocks of the others are linked by then.
    link_row(0);
    for (const std::int64_t dz : {0, 1}) {
      for (const std::int64_t dy : {0, 1, -1}) {
        if (dz > 0 || dy > 0) link_row(dy * stride_y_ + dz * stride_z_);
      }
    }
  }

  // Up to the linked level:
  std::size_t cells() const { return cells_.size(); }
  std::uint32_t cell_of(std::size_t point) const { return cell_of_[point]; }
  std::uint32_t root(std::uint32_t cell) { return sets_.find(cell); }
  std::uint32_t size(std::uint32_t cell) const { return end(cell) - cells_[cell].begin; }
  // The first point of a cell that has any.
  std::uint32_t first_point(std::uint32_t cell) const {
    std::uint32_t first = order_[cells_[cell].begin];
    for (std::size_t k = 0; k < level_; ++k) {  // points of one level keep their order
      const std::uint32_t begin = ends_[cell * levels_ + k];
      if (begin < ends_[cell * levels_ + k + 1]) first = std::min(first, order_[begin]);
    }
    return first;
  }

 private:
  // The cell of each point within its block, and its level: whether it lies in the upper half of the
  // block along each axis.
  Raw<std::uint16_t> slots_of(const Above& above, double block_size) const {
    Raw<std::uint16_t> slots = raw<std::uint16_t>(above.count);
    const std::vector<std::uint8_t> upper =
        odd_cells(above.points.get(), 3 * above.count, block_size / 2);
    for (std::size_t i = 0; i < above.count; ++i) {
      const std::size_t octant =
          upper[3 * i] | std::size_t{upper[3 * i + 1]} << 1 | std::size_t{upper[3 * i + 2]} << 2;
      slots[i] = static_cast<std::uint16_t>(octant * levels_ + above.level[i]);
    }
    return slots;
  }

  // The block of some runs, whose points come from `row` on; the row behind them.
  std::uint32_t add_block(const float* points, const CellRun* begin, const CellRun* end,
                          const Raw<std::uint16_t>& slots, std::uint32_t row) {
    start_.assign(8 * levels_, 0);
    cell_of_slot_.resize(8 * levels_);
    for (const CellRun* run = begin; run < end; ++run) {
      for (std::uint32_t i = run->begin; i < run->end; ++i) ++start_[slots[i]];
    }
    const auto first_cell = static_cast<std::uint32_t>(cells_.size());
    std::uint32_t at = row;
    for (std::size_t octant = 0; octant < 8; ++octant) {
      const std::uint32_t cell_begin = at;
      for (std::size_t k = octant * levels_; k < (octant + 1) * levels_; ++k) {
        const std::uint32_t count = start_[k];
        start_[k] = at;
        cell_of_slot_[k] = static_cast<std::uint32_t>(cells_.size());
        at += count;
        ends_.push_back(at);
      }
      if (at > cell_begin) {
        cells_.push_back({cell_begin});
      } else {
        ends_.resize(ends_.size() - levels_);
      }
    }
    for (const CellRun* run = begin; run < end; ++run) {
      for (std::uint32_t point = run->begin; point < run->end; ++point) {
        const std::uint32_t slot = start_[slots[point]]++;
        order_[slot] = point;
        cell_of_[point] = cell_of_slot_[slots[point]];
        std::copy_n(points + 3 * static_cast<std::size_t>(point), 3,
                    xyz_.get() + 3 * static_cast<std::size_t>(slot));
      }
    }
    const auto end_cell = static_cast<std::uint32_t>(cells_.size());
    blocks_.push_back({begin->key, first_cell, end_cell, false, false});
    return at;
  }

  std::uint32_t end(std::uint32_t cell) const { return ends_[cell * levels_ + level_]; }
  bool is_empty(std::uint32_t cell) const { return end(cell) == cells_[cell].begin; }

  bool is_grown(std::uint32_t cell) const {
    return end(cell) > (level_ == 0 ? cells_[cell].begin : ends_[cell * levels_ + level_ - 1]);
  }

  bool touch(std::uint32_t a, std::uint32_t b) const {
    const std::uint32_t end_a = end(a), end_b = end(b);
    for (std::uint32_t i = cells_[a].begin; i < end_a; ++i) {
      for (std::uint32_t j = cells_[b].begin; j < end_b; ++j) {
        const float dx = xyz_[3 * i] - xyz_[3 * j];
        const float dy = xyz_[3 * i + 1] - xyz_[3 * j + 1];
        const float dz = xyz_[3 * i + 2] - xyz_[3 * j + 2];
        if (dx * dx + dy * dy + dz * dz <= radius2_) return true;
      }
    }
    return false;
  }

  void link_inside(Block& block) {
    block.grown = false;
    for (std::uint32_t c = block.begin; c < block.end; ++c) block.grown |= is_grown(c);
    if (!block.grown) return;
    for (std::uint32_t a = block.begin; a < block.end; ++a) {
      for (std::uint32_t b = a + 1; b < block.end; ++b) {
        if (sets_.find(a) != sets_.find(b) && touch(a, b)) sets_.unite(a, b);
      }
    }
    block.whole = true;
    for (std::uint32_t a = block.begin; a < block.end; ++a) {
      block.whole &= !is_empty(a) && sets_.find(a) == sets_.find(block.begin);
    }
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

  void link(const Block& one, const Block& other) {
    if (!one.grown && !other.grown) return;
    const bool whole = one.whole && other.whole;
    if (whole && sets_.find(one.begin) == sets_.find(other.begin)) return;
    for (std::uint32_t a = one.begin; a < one.end; ++a) {
      if (is_empty(a)) continue;
      std::uint32_t root = sets_.find(a);
      for (std::uint32_t b = other.begin; b < other.end; ++b) {
        if (!whole && root == sets_.find(b)) continue;
        if (!touch(a, b)) continue;
        root = sets_.unite(a, b);
        if (whole) return;
      }
    }
  }

  std::size_t levels_, level_ = 0;
  float radius2_;
  std::int64_t stride_y_ = 0, stride_z_ = 0;
  Raw<std::uint32_t> order_, cell_of_;
  Raw<float> xyz_;
  std::vector<Cell> cells_;
  std::vector<std::uint32_t> ends_, start_;  // of each level of each cell, or of a block's cell
  std::vector<std::uint32_t> cell_of_slot_;  // of a block
  std::vector<Block> blocks_;
  DisjointSets sets_;
};

// The clusters of the points up to a level, which is linked.
Clusters clusters_of(Lattice& lattice, const Above& above, std::size_t level,
                     std::size_t min_points, std::size_t max_points) {
  const std::size_t cells = lattice.cells();
  std::vector<std::uint32_t> root_of(cells), size(cells, 0), first(cells, 0xFFFFFFFFu);
  for (std::uint32_t c = 0; c < cells; ++c) {
    const std::uint32_t root = root_of[c] = lattice.root(c);
    if (lattice.size(c) == 0) continue;
    size[root] += lattice.size(c);
    first[root] = std::min(first[root], lattice.first_point(c));
  }
  std::vector<std::uint32_t> kept;
  for (std::uint32_t c = 0; c < cells; ++c) {
    if (size[c] >= std::max<std::size_t>(min_points, 1) && size[c] <= max_points) kept.push_back(c);
  }
  std::sort(kept.begin(), kept.end(),
            [&](std::uint32_t a, std::uint32_t b) { return first[a] < first[b]; });
  Clusters result;
  result.offsets.push_back(0);
  std::vector<std::int64_t> next(cells, -1);  // where a point goes
  for (const std::uint32_t root : kept) {
    next[root] = result.offsets.back();
    result.offsets.push_back(result.offsets.back() + size[root]);
  }
  result.points.resize(static_cast<std::size_t>(result.offsets.back()));
  for (std::size_t i = 0; i < above.count; ++i) {
    if (above.level[i] > level) continue;
    std::int64_t& at = next[root_of[lattice.cell_of(i)]];
    if (at >= 0) result.points[static_cast<std::size_t>(at++)] = above.rows[i];
  }
  return result;
}

}  // namespace

Clusters clusters_above(const float* points, const float* heights, std::size_t n,
                        const std::vector<double>& cuts, double radius, std::size_t min_points,
                        std::size_t max_points) {
  std::vector<double> falling = cuts;
  std::sort(falling.begin(), falling.end(), std::greater<>());
  const Above above(points, heights, n, falling);
  Lattice lattice(above, falling.size(), radius);
  std::vector<Clusters> found(falling.size());
  for (std::size_t k = 0; k < falling.size(); ++k) {
    lattice.link_level(k);
    found[k] = clusters_of(lattice, above, k, min_points, max_points);
  }
  Clusters result;
  result.offsets.push_back(0);
  for (const double cut : cuts) {
    const auto k = std::find(falling.begin(), falling.end(), cut) - falling.begin();
    const Clusters& part = found[static_cast<std::size_t>(k)];
    const std::int64_t before = result.offsets.back();
    for (std::size_t i = 1; i < part.offsets.size(); ++i) {
      result.offsets.push_back(before + part.offsets[i]);
    }
    result.points.insert(result.points.end(), part.points.begin(), part.points.end());
  }
  return result;
}

Segments segments_of(const Clusters& clusters, const float* points, const float* heights) {
  const std::size_t count = clusters.offsets.size() - 1;
  Segments found;
  found.points.resize(3 * clusters.points.size());
  found.centroids.resize(3 * count);
  found.heights.resize(count);
  float* to = found.points.data();
  for (std::size_t s = 0; s < count; ++s) {
    const auto begin = static_cast<std::size_t>(clusters.offsets[s]);
    const auto end = static_cast<std::size_t>(clusters.offsets[s + 1]);
    double sum[4] = {0.0, 0.0, 0.0, 0.0};
    for (std::size_t k = begin; k < end; ++k) {
      const std::size_t i = clusters.points[k];
      for (std::size_t a = 0; a < 3; ++a) sum[a] += *to++ = points[3 * i + a];
      sum[3] += heights[i];
    }
    const auto size = static_cast<double>(end - begin);
    for (std::size_t a = 0; a < 3; ++a) found.centroids[3 * s + a] = sum[a] / size;
    found.heights[s] = static_cast<float>(sum[3] / size);
  }
  return found;
}

Clusters euclidean_clusters(const float* points, std::size_t n, double radius,
                            std::size_t min_points, std::size_t max_points) {
  const std::vector<float> heights(n, 1.0f);
  return clusters_above(points, heights.data(), n, {0.0}, radius, min_points, max_points);
}

}  // namespace segloc
