// The cells of a point grid: how they are numbered and found. Everything is static (simd/simd.h).
#pragma once

#include <cstddef>
#include <cstdint>

namespace segloc {

// Points of a cell.
struct GridRange {
  uint32_t begin, end;
};

// Four by four by four cells: a neighbourhood touches one or two, most of whose cells are empty.
struct GridBlock {
  uint64_t key, cells;  // a bit for each cell that has points; free where there is none
  uint32_t first;       // of their ranges
};

// Blocks are a table of open addressing, of 2^bits places.
struct GridCells {
  const GridBlock* blocks;
  const GridRange* ranges;
  const float *x, *y, *z;  // up to 15 values behind the last one are infinite
  int bits;
  double cell, per_metre;
};

// The nearest point to a place.
struct GridNearest {
  uint32_t point;  // kNoPoint where none is close enough
  float squared;   // distance to it; infinite where there is none
  float next;      // no other point is nearer than this, squared
};
static constexpr uint32_t kNoPoint = 0xFFFFFFFFu;

// Cells of either side of the origin.
static constexpr int64_t kGridAxis = int64_t{1} << 20;
static constexpr int kBlockShift = 2;

static inline uint64_t grid_key(int64_t x, int64_t y, int64_t z) {
  return (static_cast<uint64_t>(x + kGridAxis) << 42) |
         (static_cast<uint64_t>(y + kGridAxis) << 21) | static_cast<uint64_t>(z + kGridAxis);
}

static inline uint64_t grid_bit(int64_t x, int64_t y, int64_t z) {
  constexpr int64_t inside = (1 << kBlockShift) - 1;
  return uint64_t{1} << ((x & inside) << (2 * kBlockShift) | (y & inside) << kBlockShift |
                         (z & inside));
}

// The highest bits of a product depend on all of the key.
static inline uint64_t first_slot(uint64_t key, int bits) {
  return key * 0x9E3779B97F4A7C15ull >> (64 - bits);
}

// Where a block is or would be in a table of 2^bits.
static inline uint64_t grid_slot(const GridBlock* blocks, int bits, uint64_t key) {
  const uint64_t last = (uint64_t{1} << bits) - 1;
  uint64_t slot = first_slot(key, bits);
  while (blocks[slot].cells != 0 && blocks[slot].key != key) slot = (slot + 1) & last;
  return slot;
}

static inline uint32_t ones(uint64_t v) {
#ifdef __POPCNT__
  return static_cast<uint32_t>(__builtin_popcountll(v));
#else
  v -= (v >> 1) & 0x5555555555555555ull;
  v = (v & 0x3333333333333333ull) + ((v >> 2) & 0x3333333333333333ull);
  v = (v + (v >> 4)) & 0x0f0f0f0f0f0f0f0full;
  return static_cast<uint32_t>((v * 0x0101010101010101ull) >> 56);
#endif
}

// The points of a cell of a block; null where there are none.
static inline const GridRange* range_in(const GridBlock& block, const GridRange* ranges,
                                        uint64_t cell) {
  if ((block.cells & cell) == 0) return nullptr;
  return ranges + block.first + ones(block.cells & (cell - 1));
}

}  // namespace segloc
