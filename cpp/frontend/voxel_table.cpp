#include "frontend/voxel_table.h"

#include <algorithm>
#include <utility>

namespace segloc {
namespace {

constexpr std::size_t kAhead = 12;  // voxels that are fetched before they are needed

template <typename Visit>
void each(const std::vector<std::uint64_t>& keys, const VoxelTable& table, Visit&& visit) {
  for (std::size_t i = 0; i < keys.size(); ++i) {
    table.prefetch(keys[std::min(i + kAhead, keys.size() - 1)]);
    visit(i);
  }
}

}  // namespace

void VoxelTable::reset(std::size_t capacity) {
  keys_.assign(capacity, kFree);
  sums_.assign(capacity, VoxelSum{});
  mask_ = capacity - 1;
  used_ = 0;
}

void VoxelTable::grow() {
  const std::vector<std::uint64_t> keys = std::move(keys_);
  const std::vector<VoxelSum> sums = std::move(sums_);
  reset(2 * keys.size());
  for (std::size_t i = 0; i < keys.size(); ++i) {
    if (keys[i] != kFree) add(keys[i], sums[i]);
  }
}

// What was pushed on past the slot moves back, so that no search ends too soon.
void VoxelTable::erase(std::size_t slot) {
  for (std::size_t next = (slot + 1) & mask_; keys_[next] != kFree; next = (next + 1) & mask_) {
    const std::size_t wanted = home(keys_[next]);
    if (((next - wanted) & mask_) < ((next - slot) & mask_)) continue;
    keys_[slot] = keys_[next];
    sums_[slot] = sums_[next];
    slot = next;
  }
  keys_[slot] = kFree;
  --used_;
}

void VoxelRuns::add_to(VoxelTable& table) const {
  each(keys_, table, [&](std::size_t i) { table.add(keys_[i], sums_[i]); });
}

void VoxelRuns::remove_from(VoxelTable& table) const {
  each(keys_, table, [&](std::size_t i) { table.remove(keys_[i], sums_[i]); });
}

}  // namespace segloc
