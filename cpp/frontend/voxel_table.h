// Integer sums of points per voxel: additions can be undone exactly.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <vector>

#include "common/portability.h"

namespace segloc {

// A coordinate in units of 1 / 4096 of a voxel's edge. The cell is what is left of it without the
// last 12 bits.
using Fixed = std::int64_t;
constexpr int kFractionBits = 12;
constexpr Fixed kOne = Fixed{1} << kFractionBits;

// Cells are distinguished up to multiples of 2^21 along each axis.
constexpr int kAxisBits = 21;
constexpr std::uint64_t kAxisMask = (std::uint64_t{1} << kAxisBits) - 1;

inline std::uint64_t voxel_key(Fixed x, Fixed y, Fixed z) {
  const auto cell = [](Fixed v) { return static_cast<std::uint64_t>(v >> kFractionBits); };
  return (cell(z) & kAxisMask) << 2 * kAxisBits | (cell(y) & kAxisMask) << kAxisBits |
         (cell(x) & kAxisMask);
}

// The cell of a key that lies within 2^20 cells of `near` along each axis.
inline std::array<Fixed, 3> cell_near(std::uint64_t key, const std::array<Fixed, 3>& near) {
  constexpr Fixed kHalf = Fixed{1} << (kAxisBits - 1);
  std::array<Fixed, 3> cell;
  for (std::size_t a = 0; a < 3; ++a) {
    const Fixed first = near[a] - kHalf;
    const std::uint64_t bits = key >> (a * kAxisBits);
    cell[a] = first + static_cast<Fixed>((bits - static_cast<std::uint64_t>(first)) & kAxisMask);
  }
  return cell;
}

// How many points lie in a voxel, and the sums of their places in it. Sums of 2^20 points fit.
struct VoxelSum {
  static constexpr std::uint32_t kMostPoints = std::uint32_t{1} << 20;

  std::uint32_t count = 0, x = 0, y = 0, z = 0;

  void add(const VoxelSum& other) {
    count += other.count;
    x += other.x;
    y += other.y;
    z += other.z;
  }
  void remove(const VoxelSum& other) {
    count -= other.count;
    x -= other.x;
    y -= other.y;
    z -= other.z;
  }
  // Coordinates of the mean, in voxels.
  std::array<double, 3> mean(const std::array<Fixed, 3>& cell) const {
    const double units = double(kOne) * count;
    return {double(cell[0]) + x / units, double(cell[1]) + y / units, double(cell[2]) + z / units};
  }
};

// An open-addressed hash of voxels. Neighbours along x lie in one line of the cache.
class VoxelTable {
 public:
  explicit VoxelTable(std::size_t capacity = 1024) { reset(capacity); }

  // What is beyond the most points of a voxel is left out.
  void add(std::uint64_t key, const VoxelSum& points) {
    std::size_t slot = find(key);
    if (keys_[slot] == kFree) {
      if (2 * (used_ + 1) > keys_.size()) {
        grow();
        slot = find(key);
      }
      keys_[slot] = key;
      sums_[slot] = VoxelSum{};
      ++used_;
    }
    VoxelSum& sum = sums_[slot];
    if (sum.count + points.count <= VoxelSum::kMostPoints) sum.add(points);
  }

  // Takes away what was added before.
  void remove(std::uint64_t key, const VoxelSum& points) {
    const std::size_t slot = find(key);
    if (keys_[slot] == kFree) return;
    sums_[slot].remove(points);
    if (sums_[slot].count == 0) erase(slot);
  }

  // For a voxel that is soon to be added to, or removed from.
  void prefetch(std::uint64_t key) const {
    segloc::prefetch(&keys_[home(key)]);
    prefetch_to_write(&sums_[home(key)]);
  }

  std::size_t size() const { return used_; }
  std::size_t nbytes() const { return keys_.size() * (sizeof(std::uint64_t) + sizeof(VoxelSum)); }

  // Calls visit(key, sum) for every voxel, in no order that means anything.
  template <typename Visit>
  void visit(Visit&& visit) const {
    for (std::size_t i = 0; i < keys_.size(); ++i) {
      if (keys_[i] != kFree) visit(keys_[i], sums_[i]);
    }
  }

 private:
  static constexpr std::uint64_t kFree = ~std::uint64_t{0};  // keys have 63 bits

  std::size_t home(std::uint64_t key) const {
    const std::uint64_t row = (key >> 3) * 0x9E3779B97F4A7C15ull;
    return static_cast<std::size_t>((row >> 32) << 3 | (key & 7)) & mask_;
  }
  std::size_t find(std::uint64_t key) const {
    std::size_t slot = home(key);
    while (keys_[slot] != key && keys_[slot] != kFree) slot = (slot + 1) & mask_;
    return slot;
  }
  void reset(std::size_t capacity);
  void grow();
  void erase(std::size_t slot);

  std::vector<std::uint64_t> keys_;
  std::vector<VoxelSum> sums_;  // of a free slot: anything
  std::size_t used_ = 0, mask_ = 0;
};

// Points on their way into a table, or out of it. Those that follow one another in one voxel, as
// most of a scan do, are added up first.
class VoxelRuns {
 public:
  void clear() {
    keys_.clear();
    sums_.clear();
  }

  void append(Fixed x, Fixed y, Fixed z) {
    const auto place = [](Fixed v) { return static_cast<std::uint32_t>(v & (kOne - 1)); };
    const std::uint64_t key = voxel_key(x, y, z);
    const VoxelSum point{1, place(x), place(y), place(z)};
    if (!keys_.empty() && keys_.back() == key && sums_.back().count < VoxelSum::kMostPoints) {
      sums_.back().add(point);
    } else {
      keys_.push_back(key);
      sums_.push_back(point);
    }
  }

  void add_to(VoxelTable& table) const;
  void remove_from(VoxelTable& table) const;

  std::size_t nbytes() const {
    return keys_.capacity() * sizeof(std::uint64_t) + sums_.capacity() * sizeof(VoxelSum);
  }

 private:
  std::vector<std::uint64_t> keys_;
  std::vector<VoxelSum> sums_;
};

}  // namespace segloc
