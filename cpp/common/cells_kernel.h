// Checks, extents and cells of coordinates. The compiler turns these loops into vectors.
#pragma once

#include "simd/kernels.h"
#include "simd/simd.h"

namespace segloc {
namespace SEGLOC_ISA {
namespace {

bool all_below(const float* values, size_t count, float limit) {
  uint32_t limit_bits;
  copy_bytes(&limit_bits, &limit, sizeof(limit_bits));
  uint32_t faults = 0;  // no early exit
  for (size_t i = 0; i < count; ++i) {
    uint32_t bits;
    copy_bytes(&bits, values + i, sizeof(bits));
    faults += (bits & 0x7fffffff) >= limit_bits;  // NaN and infinity have the largest bits
  }
  return faults == 0;
}

void extent(const float* values, size_t runs, float* low, float* high) {
  constexpr size_t kVectors = kExtentRun / kWidth;
  Vec least[kVectors], most[kVectors];
  SEGLOC_UNROLL
  for (size_t k = 0; k < kVectors; ++k) least[k] = most[k] = load(values + k * kWidth);
  for (size_t i = 1; i < runs; ++i) {
    SEGLOC_UNROLL
    for (size_t k = 0; k < kVectors; ++k) {
      const Vec v = load(values + i * kExtentRun + k * kWidth);
      least[k] = min(v, least[k]);
      most[k] = max(v, most[k]);
    }
  }
  SEGLOC_UNROLL
  for (size_t k = 0; k < kVectors; ++k) {
    store(low + k * kWidth, least[k]);
    store(high + k * kWidth, most[k]);
  }
}

// A reciprocal would round some places into the next cell.
void cell_numbers(const float* values, size_t count, double size, int32_t* cells) {
  for (size_t i = 0; i < count; ++i) {
    const double at = static_cast<double>(values[i]) / size;
    const auto whole = static_cast<int32_t>(at);
    cells[i] = whole - static_cast<int32_t>(at < static_cast<double>(whole));
  }
}

void cell_keys(const int32_t* __restrict cells, size_t count, uint32_t stride_y, uint32_t stride_z,
               uint32_t base, uint64_t* __restrict keys) {
  for (size_t i = 0; i < count; ++i) {
    const auto x = static_cast<uint32_t>(cells[3 * i]);
    const auto y = static_cast<uint32_t>(cells[3 * i + 1]);
    const auto z = static_cast<uint32_t>(cells[3 * i + 2]);
    const uint32_t key = x + y * stride_y + z * stride_z - base;
    keys[i] = key;
  }
}

}  // namespace
}  // namespace SEGLOC_ISA
}  // namespace segloc
