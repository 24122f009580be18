// The loops of the votes for poses: where each match votes, which windows of cells may be full, and
// which matches they hold.
#pragma once

#include "simd/kernels.h"
#include "simd/simd.h"

namespace segloc {
namespace SEGLOC_ISA {
namespace {

// Plain loops, which the compiler turns into vectors. No fused products: every instruction set must
// find the same cells.
void vote_cells(const MatchArrays& f, size_t count, const VoteLattice& l, uint32_t* cells) {
  for (size_t k = 0; k < count; ++k) {
    const float x = f.mx[k] - (l.cosine * f.qx[k] - l.sine * f.qy[k]) - l.low_x;
    const float y = f.my[k] - (l.sine * f.qx[k] + l.cosine * f.qy[k]) - l.low_y;
    const auto column = static_cast<uint32_t>(static_cast<int32_t>(x * l.per_metre));
    const auto row = static_cast<uint32_t>(static_cast<int32_t>(y * l.per_metre));
    cells[k] = (row & l.mask_y) << l.bits_x | (column & l.mask_x);
  }
}

constexpr size_t kLanes = 32;

// A bound of the votes in the window of two by two cells that end with these and those before them.
inline uint16_t window_votes(uint16_t before_above, uint16_t above, uint16_t before_here,
                             uint16_t here) {
  return static_cast<uint16_t>((above & kVotes) + (before_above & kVotes) + (here & kVotes) +
                               (before_here & kVotes));
}

// The bounds of a few windows, and the largest.
inline uint16_t sums_of(const uint16_t* above, const uint16_t* here, uint16_t* sums) {
  const uint16_t *before_above = above - 1, *before_here = here - 1;
  uint16_t most = 0;
  for (size_t i = 0; i < kLanes; ++i) {
    sums[i] = window_votes(before_above[i], above[i], before_here[i], here[i]);
    most = sums[i] > most ? sums[i] : most;
  }
  return most;
}

// Whether any of the windows, a multiple of the lanes, may hold `fewest` votes.
inline bool any_full(const uint16_t* above, const uint16_t* here, size_t windows,
                     uint32_t fewest) {
  uint16_t most[kLanes] = {}, highest = 0;
  for (size_t first = 0; first < windows; first += kLanes) {
    const uint16_t *a = above + first, *b = here + first;
    const uint16_t *before_a = a - 1, *before_b = b - 1;
    for (size_t i = 0; i < kLanes; ++i) {
      const uint16_t sum = window_votes(before_a[i], a[i], before_b[i], b[i]);
      most[i] = sum > most[i] ? sum : most[i];
    }
  }
  for (size_t i = 0; i < kLanes; ++i) highest = most[i] > highest ? most[i] : highest;
  return highest >= fewest;
}

// The windows of the row `y` that hold `fewest` votes, in the row `above` and in the row `here`,
// the first ones of a row together with the last.
size_t full_in_row(const uint16_t* above, const uint16_t* here, size_t columns, uint32_t y,
                   uint32_t fewest, uint32_t* found) {
  const size_t block = columns % (4 * kLanes) == 0 ? 4 * kLanes : kLanes, last = columns - 1;
  size_t count = 0;
  const auto test = [&](uint32_t votes, size_t x) {
    if (votes < fewest) return;
    found[count++] = votes << kSlotBits | static_cast<uint32_t>(y * columns + x);
  };
  test(window_votes(above[last], above[0], here[last], here[0]), 0);
  for (size_t start = 0; start < columns; start += block) {
    if (!any_full(above + start, here + start, block, fewest)) continue;
    for (size_t first = start; first < start + block; first += kLanes) {
      uint16_t sums[kLanes];
      if (sums_of(above + first, here + first, sums) < fewest) continue;
      // The first window of a row spans its ends: it was tested above.
      for (size_t i = first == 0; i < kLanes; ++i) test(sums[i], first + i);
    }
  }
  return count;
}

// Rows are cleared as soon as no window needs them, while they are in the first cache.
size_t full_windows(uint16_t* cells, size_t columns, size_t rows, uint32_t fewest,
                    uint32_t* found) {
  size_t count = 0;
  for (size_t y = 1; y <= rows; ++y) {  // the last window takes the last row and the first one
    uint16_t* const above = cells + (y - 1) * columns;
    const size_t row = y == rows ? 0 : y;
    count += full_in_row(above, cells + row * columns, columns, static_cast<uint32_t>(row), fewest,
                         found + count);
    if (y > 1) clear_bytes(above, columns * sizeof(uint16_t));
  }
  clear_bytes(cells, columns * sizeof(uint16_t));
  return count;
}

// The matches whose cell has its bit set.
size_t matches_inside(const uint32_t* cells, size_t count, const uint32_t* wanted,
                      uint32_t* inside) {
  size_t found = 0, k = 0;
  for (; k + kWidth <= count; k += kWidth) {
    found = append_fast(bits_at(wanted, cells + k), k, inside, found);
  }
  for (; k < count; ++k) {
    inside[found] = static_cast<uint32_t>(k);
    found += wanted[cells[k] >> 5] >> (cells[k] & 31) & 1u;
  }
  return found;
}

}  // namespace
}  // namespace SEGLOC_ISA
}  // namespace segloc
