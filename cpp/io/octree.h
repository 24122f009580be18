// Occupied cells as the occupancy bytes of an octree, breadth first.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <vector>

namespace segloc {

constexpr int kMostOctreeLevels = 21;  // three numbers of a cell fit into 63 bits

// One byte per node, the root first and each level sorted by x, then y, then z: bit 4x + 2y + z is
// set if the child in that half of each axis is occupied. The n cells, (n, 3) row-major, are from
// 0 to 2^levels - 1; cells that occur twice count once. Throws std::invalid_argument where one is
// not.
std::vector<std::uint8_t> octree_encode(const std::int32_t* cells, std::size_t n, int levels);

// Where cells lie: cell c of an axis is voxel c + low, and each voxel has 2^bits parts along it.
struct VoxelGrid {
  std::array<std::int64_t, 3> low;
  std::array<double, 3> origin;  // points are relative to it
  double voxel;
  int bits;
};

// The centres of parts of the cells of such bytes, (count, 3) row-major, sorted by x, then y, then
// z of their cells. `parts` has `bits` bits (0, 1, 2 or 4) for each coordinate, which fill its
// bytes from their lowest bit on. Throws std::invalid_argument where `codes` stand for another
// number of cells, or are too many or few. Takes no more memory than about 200 bytes for each of
// `codes`.
std::vector<float> octree_points(const std::uint8_t* codes, std::size_t length, int levels,
                                 std::size_t count, const std::uint8_t* parts,
                                 const VoxelGrid& grid);

}  // namespace segloc
