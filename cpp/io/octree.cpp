#include "io/octree.h"

#include <algorithm>
#include <stdexcept>

#include "common/cells.h"

namespace segloc {
namespace {

struct Node {
  std::int32_t x, y, z;
};

void require_levels(int levels) {
  if (levels < 1 || levels > kMostOctreeLevels)
    throw std::invalid_argument("an octree has 1 to 21 levels");
}

std::size_t children_of(const std::uint8_t* codes, std::size_t nodes) {
  std::size_t count = 0;
  bool childless = false;
  for (std::size_t i = 0; i < nodes; ++i) {
    unsigned bits = codes[i];
    childless |= bits == 0;
    bits = (bits & 0x55U) + (bits >> 1 & 0x55U);
    bits = (bits & 0x33U) + (bits >> 2 & 0x33U);
    count += (bits & 0x0fU) + (bits >> 4);
  }
  if (childless) throw std::invalid_argument("the octree has a node without children");
  return count;
}

// The children of sorted nodes, sorted: first all of the lower half along x of the nodes that share
// x; within these, all of the lower half along y of the nodes that share y, too.
std::vector<Node> children(const std::vector<Node>& nodes, const std::uint8_t* codes) {
  const std::size_t count = children_of(codes, nodes.size());
  std::vector<Node> found(count + 1);  // a child is written before it is known to be one
  Node* next = found.data();
  std::size_t slab_end = 0;
  for (std::size_t slab = 0; slab < nodes.size(); slab = slab_end) {
    const std::int32_t x = nodes[slab].x;
    while (slab_end < nodes.size() && nodes[slab_end].x == x) ++slab_end;
    for (int bx = 0; bx < 2; ++bx) {
      std::size_t row_end = slab;
      for (std::size_t row = slab; row < slab_end; row = row_end) {
        const std::int32_t y = nodes[row].y;
        while (row_end < slab_end && nodes[row_end].y == y) ++row_end;
        for (int by = 0; by < 2; ++by) {
          for (std::size_t i = row; i < row_end; ++i) {
            const unsigned pair = codes[i] >> (4 * bx + 2 * by) & 3U;
            *next = {2 * x + bx, 2 * y + by, 2 * nodes[i].z};
            next += pair & 1U;
            *next = {2 * x + bx, 2 * y + by, 2 * nodes[i].z + 1};
            next += pair >> 1;
          }
        }
      }
    }
  }
  found.resize(count);
  return found;
}

// What an axis has at its cells and their parts; a table of it where it is small.
class Axis {
 public:
  Axis(const VoxelGrid& grid, std::size_t axis, std::int32_t most)
      : voxel_(grid.voxel), origin_(grid.origin[axis]), low_(grid.low[axis]), bits_(grid.bits) {
    const std::size_t entries = (static_cast<std::size_t>(most) + 1) << bits_;
    if (entries > kMostEntries) return;
    table_.resize(entries);
    const std::size_t mask = (std::size_t{1} << bits_) - 1;
    for (std::size_t i = 0; i < entries; ++i) table_[i] = computed(i >> bits_, unsigned(i & mask));
  }

  float at(std::int32_t cell, unsigned part) const {
    const auto place = static_cast<std::size_t>(cell);
    return table_.empty() ? computed(place, part) : table_[place << bits_ | part];
  }

 private:
  static constexpr std::size_t kMostEntries = std::size_t{1} << 18;

  float computed(std::size_t cell, unsigned part) const {
    const double inner = (double(part) + 0.5) / double(1U << bits_);
    const double place = double(static_cast<std::int64_t>(cell) + low_) + inner;
    return static_cast<float>(place * voxel_ - origin_);
  }

  double voxel_, origin_;
  std::int64_t low_;
  int bits_;
  std::vector<float> table_;
};

std::vector<float> centres(const std::vector<Node>& cells, const std::uint8_t* parts,
                           const VoxelGrid& grid) {
  Node most{0, 0, 0};
  for (const Node& cell : cells)
    most = {std::max(most.x, cell.x), std::max(most.y, cell.y), std::max(most.z, cell.z)};
  const Axis x(grid, 0, most.x), y(grid, 1, most.y), z(grid, 2, most.z);
  const auto bits = static_cast<std::size_t>(grid.bits);
  const unsigned mask = (1U << bits) - 1;
  std::size_t bit = 0;  // of the next part
  const auto part = [&] {
    const unsigned value = bits ? parts[bit / 8] >> bit % 8 & mask : 0;
    bit += bits;
    return value;
  };
  std::vector<float> points(3 * cells.size());
  float* next = points.data();
  for (const Node& cell : cells) {
    *next++ = x.at(cell.x, part());
    *next++ = y.at(cell.y, part());
    *next++ = z.at(cell.z, part());
  }
  return points;
}

}  // namespace

std::vector<std::uint8_t> octree_encode(const std::int32_t* cells, std::size_t n, int levels) {
  require_levels(levels);
  const std::uint64_t mask = (1ULL << levels) - 1;
  std::vector<std::uint64_t> keys(n);
  for (std::size_t i = 0; i < n; ++i) {
    for (int axis = 0; axis < 3; ++axis) {
      const std::int32_t cell = cells[3 * i + axis];
      if (cell < 0 || cell >> levels != 0)
        throw std::invalid_argument("a cell lies outside of the octree");
      keys[i] = keys[i] << levels | static_cast<std::uint64_t>(cell);
    }
  }
  std::vector<std::vector<std::uint8_t>> rows(static_cast<std::size_t>(levels));
  for (std::size_t level = rows.size(); level-- > 0;) {  // the deepest first
    std::vector<std::uint32_t> child(keys.size());
    for (std::size_t i = 0; i < keys.size(); ++i) {
      const std::uint64_t x = keys[i] >> 2 * levels, y = keys[i] >> levels & mask,
                          z = keys[i] & mask;
      child[i] = static_cast<std::uint32_t>(4 * (x & 1) | 2 * (y & 1) | (z & 1));
      keys[i] = (x >> 1) << 2 * levels | (y >> 1) << levels | z >> 1;
    }
    radix_sort(keys, child, 3 * levels);
    std::size_t parents = 0;
    for (std::size_t i = 0; i < keys.size(); ++i) {
      if (parents == 0 || keys[parents - 1] != keys[i]) {
        keys[parents++] = keys[i];
        rows[level].push_back(0);
      }
      rows[level].back() |= static_cast<std::uint8_t>(1U << child[i]);
    }
    keys.resize(parents);
  }
  std::vector<std::uint8_t> codes;
  for (const auto& row : rows) codes.insert(codes.end(), row.begin(), row.end());
  return codes;
}

std::vector<float> octree_points(const std::uint8_t* codes, std::size_t length, int levels,
                                 std::size_t count, const std::uint8_t* parts,
                                 const VoxelGrid& grid) {
  require_levels(levels);
  if (length == 0 && count == 0) return {};
  std::vector<Node> nodes{{0, 0, 0}};
  std::size_t at = 0;
  for (int level = 0; level < levels; ++level) {
    if (nodes.size() > length - at) throw std::invalid_argument("the octree is cut short");
    const std::uint8_t* row = codes + at;
    at += nodes.size();
    nodes = children(nodes, row);
  }
  if (at != length) throw std::invalid_argument("the octree has more nodes than it needs");
  if (nodes.size() != count) throw std::invalid_argument("the octree has another number of cells");
  return centres(nodes, parts, grid);
}

}  // namespace segloc
