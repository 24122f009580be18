#include "io/octree.h"

#include <algorithm>
#include <array>
#include <stdexcept>
#include <utility>

namespace segloc {
namespace {

// Bit i of v at bit 3 i.
std::uint64_t spread(std::uint64_t v) {
  v = (v | v << 32) & 0x001f00000000ffffULL;
  v = (v | v << 16) & 0x001f0000ff0000ffULL;
  v = (v | v << 8) & 0x100f00f00f00f00fULL;
  v = (v | v << 4) & 0x10c30c30c30c30c3ULL;
  return (v | v << 2) & 0x1249249249249249ULL;
}

// Bit 3 i of v at bit i.
std::uint64_t gathered(std::uint64_t v) {
  v &= 0x1249249249249249ULL;
  v = (v | v >> 2) & 0x10c30c30c30c30c3ULL;
  v = (v | v >> 4) & 0x100f00f00f00f00fULL;
  v = (v | v >> 8) & 0x001f0000ff0000ffULL;
  v = (v | v >> 16) & 0x001f00000000ffffULL;
  return (v | v >> 32) & 0x1fffffULL;
}

void require_levels(int levels) {
  if (levels < 1 || levels > kMostOctreeLevels)
    throw std::invalid_argument("an octree has 1 to 21 levels");
}

// Sorts keys of so many bits, by radix.
template <typename Key>
void sort_keys(std::vector<Key>& keys, int bits) {
  constexpr int kDigit = 8;  // so few places are written at a time that all stay in cache
  std::vector<Key> sorted(keys.size());
  for (int shift = 0; shift < bits; shift += kDigit) {
    const auto digit = [shift](Key key) { return (key >> shift) & ((1U << kDigit) - 1); };
    std::array<std::size_t, std::size_t{1} << kDigit> next{};
    for (const Key key : keys) ++next[digit(key)];
    std::size_t sum = 0;
    for (std::size_t& n : next) sum += std::exchange(n, sum);
    for (const Key key : keys) sorted[next[digit(key)]++] = key;
    keys.swap(sorted);
  }
}

int width_of(std::uint64_t most) {
  int bits = 0;
  for (; most >> bits != 0; ++bits) {
  }
  return bits;
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

// The keys of all occupied children of some nodes.
std::vector<std::uint64_t> children(const std::vector<std::uint64_t>& nodes,
                                    const std::uint8_t* codes) {
  const std::size_t count = children_of(codes, nodes.size());
  std::vector<std::uint64_t> found(count + 8);  // all eight are written, and those that count kept
  std::uint64_t* next = found.data();
  for (std::size_t i = 0; i < nodes.size(); ++i) {
    for (unsigned child = 0; child < 8; ++child) {
      *next = nodes[i] << 3 | child;
      next += codes[i] >> child & 1;
    }
  }
  found.resize(count);
  return found;
}

// How many bits a packed cell has for each axis: z takes the lowest.
struct CellBits {
  int x, y, z;
  int all() const { return x + y + z; }
};

CellBits bits_of(const std::vector<std::uint64_t>& nodes) {
  std::uint64_t seen[3] = {0, 0, 0};  // every bit of each axis that a node has
  for (const std::uint64_t key : nodes)
    for (int axis = 0; axis < 3; ++axis) seen[axis] |= key >> (2 - axis);
  // Their children have a bit more.
  return {width_of(gathered(seen[0])) + 1, width_of(gathered(seen[1])) + 1,
          width_of(gathered(seen[2])) + 1};
}

// The children of the nodes of the deepest level, as packed cells, sorted.
template <typename Key>
std::vector<Key> sorted_leaves(const std::vector<std::uint64_t>& nodes, const std::uint8_t* codes,
                               std::size_t count, const CellBits& bits) {
  std::array<Key, 8> offsets;
  for (unsigned child = 0; child < 8; ++child)
    offsets[child] = static_cast<Key>((Key{child >> 2} << (bits.y + bits.z)) |
                                      (Key{child >> 1 & 1} << bits.z) | Key{child & 1});
  std::vector<Key> keys(count + 8);  // all eight are written, and those that count kept
  Key* next = keys.data();
  for (std::size_t i = 0; i < nodes.size(); ++i) {
    const std::uint64_t node = nodes[i];
    const Key base = static_cast<Key>((2 * gathered(node >> 2) << (bits.y + bits.z)) |
                                      (2 * gathered(node >> 1) << bits.z) | 2 * gathered(node));
    for (unsigned child = 0; child < 8; ++child) {
      *next = base | offsets[child];
      next += codes[i] >> child & 1;
    }
  }
  keys.resize(count);
  sort_keys(keys, bits.all());
  return keys;
}

// The coordinates of an axis, by cell and part.
std::vector<float> coordinates(std::size_t axis, std::size_t cells, const VoxelGrid& grid) {
  const std::size_t parts = std::size_t{1} << grid.bits;
  std::vector<float> all(cells * parts);
  for (std::size_t i = 0; i < all.size(); ++i) {
    const double inner = (double(i % parts) + 0.5) / double(parts);
    const double place = double(std::int64_t(i / parts) + grid.low[axis]) + inner;
    all[i] = static_cast<float>(place * grid.voxel - grid.origin[axis]);
  }
  return all;
}

template <typename Key>
std::vector<float> centres(const std::vector<Key>& keys, const CellBits& bits,
                           const std::uint8_t* parts, const VoxelGrid& grid) {
  const int shifts[3] = {bits.y + bits.z, bits.z, 0}, widths[3] = {bits.x, bits.y, bits.z};
  Key masks[3];
  std::vector<float> places[3];
  for (std::size_t axis = 0; axis < 3; ++axis) {
    masks[axis] = (Key{1} << widths[axis]) - 1;
    Key most = 0;
    for (const Key key : keys) most = std::max(most, Key(key >> shifts[axis] & masks[axis]));
    places[axis] = coordinates(axis, std::size_t(most) + 1, grid);
  }
  const unsigned part_mask = (1U << grid.bits) - 1;
  std::vector<float> points(3 * keys.size());
  float* next = points.data();
  std::size_t bit = 0;  // of the first of a part
  for (const Key key : keys) {
    for (std::size_t axis = 0; axis < 3; ++axis, bit += std::size_t(grid.bits)) {
      const std::size_t cell = key >> shifts[axis] & masks[axis];
      const unsigned part = grid.bits ? parts[bit / 8] >> bit % 8 & part_mask : 0;
      *next++ = places[axis][cell << grid.bits | part];
    }
  }
  return points;
}

}  // namespace

std::vector<std::uint8_t> octree_encode(const std::int32_t* cells, std::size_t n, int levels) {
  require_levels(levels);
  std::vector<std::uint64_t> keys(n);
  for (std::size_t i = 0; i < n; ++i) {
    std::uint64_t key = 0;
    for (int axis = 0; axis < 3; ++axis) {
      const std::int32_t cell = cells[3 * i + axis];
      if (cell < 0 || cell >> levels != 0)
        throw std::invalid_argument("a cell lies outside of the octree");
      key |= spread(static_cast<std::uint64_t>(cell)) << (2 - axis);
    }
    keys[i] = key;
  }
  sort_keys(keys, 3 * levels);
  keys.erase(std::unique(keys.begin(), keys.end()), keys.end());
  std::vector<std::vector<std::uint8_t>> rows(static_cast<std::size_t>(levels));
  for (std::size_t level = rows.size(); level-- > 0;) {  // the deepest first
    std::size_t parents = 0;
    for (const std::uint64_t key : keys) {
      if (parents == 0 || keys[parents - 1] != key >> 3) {
        keys[parents++] = key >> 3;
        rows[level].push_back(0);
      }
      rows[level].back() |= static_cast<std::uint8_t>(1U << (key & 7));
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
  std::vector<std::uint64_t> nodes{0};
  std::size_t at = 0;
  for (int level = 0;; ++level) {
    if (nodes.size() > length - at) throw std::invalid_argument("the octree is cut short");
    if (level + 1 == levels) break;
    const std::uint8_t* row = codes + at;
    at += nodes.size();
    nodes = children(nodes, row);
  }
  if (length - at != nodes.size())
    throw std::invalid_argument("the octree has more nodes than it needs");
  if (children_of(codes + at, nodes.size()) != count)
    throw std::invalid_argument("the octree has another number of cells");
  const CellBits bits = bits_of(nodes);
  if (bits.all() < 32)
    return centres(sorted_leaves<std::uint32_t>(nodes, codes + at, count, bits), bits, parts, grid);
  return centres(sorted_leaves<std::uint64_t>(nodes, codes + at, count, bits), bits, parts, grid);
}

}  // namespace segloc
