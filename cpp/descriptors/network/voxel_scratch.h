// The memory of the voxel network's workers.
#pragma once

#include <algorithm>

#include "common/aligned.h"
#include "descriptors/network/voxel_columns.h"
#include "descriptors/network/voxel_network.h"

namespace segloc {

// All memory that one worker needs for one segment.
struct VoxelNetwork::Scratch {
  explicit Scratch(const VoxelNetwork& n)
      : cell(8 * n.a_),
        delta1((kX1 + 2) * (kY1 + 2) * (kZ1 + 2) * n.a_),
        sums(4 * kZ1 * n.b_),
        delta2((kX2 + 2) * (kY2 + 2) * (kZ2 + 2) * n.b_) {}

  void clear() {
    std::fill_n(delta1.data(), delta1.size(), 0.0f);
    std::fill_n(delta2.data(), delta2.size(), 0.0f);
    active1 = {};
    active2 = {};
  }

  AlignedFloats cell, delta1, sums, delta2;
  Active<kX1, kY1> active1{};
  Active<kX2, kY2> active2{};
};

}  // namespace segloc
