// Bounding boxes of blocks of descriptors along a few axes, so that a search skips far blocks.
#pragma once

#include <cstddef>
#include <cstdint>
#include <vector>

#include "common/aligned.h"
#include "proposals/matching/descriptor_rows.h"
#include "simd/kernels.h"

namespace segloc {

// At most kBoxAxes orthonormal directions in which rows vary most. Projecting shortens distances,
// so that a distance between projections bounds the distance between rows.
class DescriptorAxes {
 public:
  DescriptorAxes() = default;
  // Of a database; none where it is small.
  explicit DescriptorAxes(const DescriptorRows& database);

  bool empty() const { return axes_.empty(); }
  // rows (n, dim) -> projections (n, kBoxAxes), and the largest of their magnitudes.
  float project(const float* rows, std::size_t n, int threads, float* projections) const;

 private:
  std::size_t dim_ = 0;
  std::vector<float> axes_;  // (kBoxAxes, dim)
};

// Orders ids so that each `block` of them holds rows that lie near each other.
void order_by_place(const float* projections, std::size_t block, std::uint32_t* begin,
                    std::uint32_t* end);

// The extents of blocks along the axes, kBoxRun blocks a group.
class DescriptorBoxes {
 public:
  // Allocates a number of empty groups.
  void resize(std::size_t groups);
  // Takes a row into a block of a group.
  void add(std::size_t group, std::size_t block, const float* projection);

  const float* group(std::size_t index) const { return values_.data() + index * kGroupFloats; }

 private:
  static constexpr std::size_t kGroupFloats = 2 * kBoxAxes * kBoxRun;
  AlignedFloats values_;  // (groups, axes, 2, blocks): lower and upper ends
};

}  // namespace segloc
