// Parts of the shape functions of esf.h: the occupancy grid with its lines, and the bins of angles.
#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <cstdlib>

#include "descriptors/esf.h"

namespace segloc {

constexpr int kGrid = 64;

enum Kind : uint8_t { kInside, kOutside, kAcross };

// Cached properties of the line between two points.
struct Line {
  uint8_t voxels = 0;  // 0: not traced yet
  uint8_t occupied = 0;
  Kind kind = kInside;
  uint8_t share_bin = 0;
  uint32_t drawn = 0;  // how many triangles have it as a side
};

// The occupancy of the grid: bit z of column x, y.
class Grid {
 public:
  using Voxel = std::array<uint8_t, 3>;

  void clear() { columns_.fill(0); }

  static uint8_t coordinate(float v) {
    const int i = static_cast<int>(v < 0 ? std::floor(v) : std::ceil(v) - 1) + kGrid / 2;
    return static_cast<uint8_t>(std::clamp(i, 0, kGrid - 1));
  }

  void occupy(const Voxel& v) {
    const uint64_t bits = v[2] == 0 ? 3 : uint64_t{7} << (v[2] - 1);
    for (int x = std::max(v[0] - 1, 0); x <= std::min(v[0] + 1, kGrid - 1); ++x) {
      for (int y = std::max(v[1] - 1, 0); y <= std::min(v[1] + 1, kGrid - 1); ++y) {
        columns_[static_cast<std::size_t>(x * kGrid + y)] |= bits;
      }
    }
  }

  // Bresenham's line from a to b without its last voxel.
  Line trace(const Voxel& a, const Voxel& b) const {
    int position[3], step[3], length[3];
    for (int d = 0; d < 3; ++d) {
      position[d] = a[d];
      step[d] = b[d] < a[d] ? -1 : 1;
      length[d] = std::abs(int{b[d]} - int{a[d]});
    }
    const int major = length[0] >= length[1] && length[0] >= length[2] ? 0
                      : length[1] >= length[2]                         ? 1
                                                                       : 2;
    const int other = major == 0 ? 1 : 0, third = major == 2 ? 1 : 2;
    // Columns and bits are one index: bit i & 63 of word i >> 6.
    constexpr int kStride[3] = {kGrid * kGrid, kGrid, 1};
    int index = position[0] * kStride[0] + position[1] * kStride[1] + position[2];
    const int forward = step[major] * kStride[major];
    const int sideways[2] = {step[other] * kStride[other], step[third] * kStride[third]};
    const int voxels = std::max(length[major], 1), turn = 2 * length[major];
    const int rise[2] = {2 * length[other], 2 * length[third]};
    // How far the line is from its next turn along each other axis; it turns below zero.
    int left[2] = {length[major] - rise[0], length[major] - rise[1]};
    int occupied = 0;
    for (int i = 0; i < voxels; ++i) {
      const uint64_t column = columns_[static_cast<std::size_t>(index >> 6)];
      occupied += static_cast<int>(column >> (index & 63) & 1);
      for (int d = 0; d < 2; ++d) {
        const int turning = left[d] >> 31;  // all bits, or none
        index += turning & sideways[d];
        left[d] += (turning & turn) - rise[d];
      }
      index += forward;
    }
    Line line;
    line.voxels = static_cast<uint8_t>(voxels);
    line.occupied = static_cast<uint8_t>(occupied);
    line.kind = occupied >= voxels - 1 ? kInside : occupied <= 7 ? kOutside : kAcross;
    const float share = static_cast<float>(occupied) / static_cast<float>(voxels);
    line.share_bin = static_cast<uint8_t>(share * (kEsfBins - 1) + 0.5f);
    return line;
  }

 private:
  std::array<uint64_t, kGrid * kGrid> columns_{};
};

// The bin of an angle in [0, pi / 2] by its cosine: angles are rounded to one of 63 steps.
class AngleBins {
 public:
  AngleBins() {
    const double step = std::acos(0.0) / (kEsfBins - 1);
    for (std::size_t b = 0; b < kEsfBins; ++b) {
      lowest_[b] = static_cast<float>(std::cos((static_cast<double>(b) + 0.5) * step));
    }
    lowest_[kEsfBins - 1] = -1.0f;
    for (std::size_t i = 0; i <= kCells; ++i) {
      const float upper = static_cast<float>(i + 1) / kCells;
      std::size_t b = 0;
      while (lowest_[b] >= upper) ++b;
      first_[i] = static_cast<uint8_t>(b);
    }
  }
  std::size_t of(float cosine) const {
    cosine = std::min(cosine, 1.0f);
    std::size_t b = first_[static_cast<std::size_t>(cosine * kCells)];
    while (cosine < lowest_[b]) ++b;
    return b;
  }

 private:
  static constexpr std::size_t kCells = 1024;
  std::array<float, kEsfBins> lowest_;
  std::array<uint8_t, kCells + 1> first_;
};

}  // namespace segloc
