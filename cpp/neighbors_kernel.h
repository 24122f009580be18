// Dilated nearest neighbours: for each query the K*D nearest sources, sorted by distance and then
// by index, the query itself included; of these every D-th.
#pragma once

#include "kernels.h"
#include "simd.h"

namespace segloc {
namespace SEGLOC_ISA {
namespace {

constexpr size_t kColumns = 16;
constexpr float kLargest = 3.402823466e38f;

// An upper bound for the m-th smallest of d: the m-th smallest among the `Kept` lowest of each
// column (d[j] is in column j % 16). Few sources lie below it, so few need sorting.
template <size_t Kept>
inline float rank_bound(const float* d, size_t sources, size_t m, float* low) {
  constexpr size_t kVecs = kColumns / kWidth;
  Vec lowest[Kept][kVecs];
  SEGLOC_UNROLL
  for (size_t r = 0; r < Kept; ++r) {
    SEGLOC_UNROLL
    for (size_t v = 0; v < kVecs; ++v) lowest[r][v] = broadcast(__builtin_inff());
  }
  for (size_t j = 0; j < sources; j += kColumns) {
    SEGLOC_UNROLL
    for (size_t v = 0; v < kVecs; ++v) {
      Vec value = load(d + j + v * kWidth);
      SEGLOC_UNROLL
      for (size_t r = 0; r < Kept; ++r) {
        const Vec other = max(lowest[r][v], value);
        lowest[r][v] = min(lowest[r][v], value);
        value = other;
      }
    }
  }
  SEGLOC_UNROLL
  for (size_t r = 0; r < Kept; ++r) {
    SEGLOC_UNROLL
    for (size_t v = 0; v < kVecs; ++v) store(low + r * kColumns + v * kWidth, lowest[r][v]);
  }
  // The m-th smallest is the least value with at least m values not above it.
  const Vec rank = broadcast(static_cast<float>(m) - 0.5f);
  Vec bound = broadcast(__builtin_inff());
  for (size_t i = 0; i < Kept * kColumns; i += kWidth) {
    const Vec value = load(low + i);
    Vec count = broadcast(0.0f);
    for (size_t j = 0; j < Kept * kColumns; ++j) {
      count = count_not_above(count, broadcast(low[j]), value);
    }
    bound = min(bound, choose(count, rank, value, bound));
  }
  return -reduce_max(broadcast(0.0f) - bound);
}

// A bound below which lie all of the m nearest, and not many more.
inline float bound_of_nearest(const float* d, size_t sources, size_t m, float* low) {
  const size_t rows = sources / kColumns;
  if (m < 12 && rows > 1) return rank_bound<1>(d, sources, m, low);
  if (m < 24 && rows > 2) return rank_bound<2>(d, sources, m, low);
  if (m < 48 && rows > 4) return rank_bound<4>(d, sources, m, low);
  if (m < 96 && rows > 8) return rank_bound<8>(d, sources, m, low);
  return kLargest;
}

// Indices of the values up to `bound`, in order; the values go to `kept`.
inline size_t compress(const float* d, size_t sources, float bound, float* kept, int32_t* index) {
  size_t count = 0;
#if defined(__AVX512F__)
  const __m512 limit = _mm512_set1_ps(bound);
  __m512i lane = _mm512_setr_epi32(0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15);
  for (size_t j = 0; j < sources; j += 16) {
    const __m512 value = _mm512_loadu_ps(d + j);
    const __mmask16 mask = _mm512_cmp_ps_mask(value, limit, _CMP_LE_OQ);
    _mm512_storeu_ps(kept + count, _mm512_maskz_compress_ps(mask, value));
    _mm512_storeu_si512(index + count, _mm512_maskz_compress_epi32(mask, lane));
    lane = _mm512_add_epi32(lane, _mm512_set1_epi32(16));
    count += static_cast<size_t>(__builtin_popcount(mask));
  }
#else
  const Vec limit = broadcast(bound);
  for (size_t j = 0; j < sources; j += kWidth) {
    for (uint32_t hits = less_equal(load(d + j), limit); hits != 0; hits &= hits - 1) {
      const size_t i = j + static_cast<size_t>(__builtin_ctz(hits));
      kept[count] = d[i];
      index[count++] = static_cast<int32_t>(i);
    }
  }
#endif
  return count;
}

// Sorts `count` values (padded with infinity to a multiple of 16) by counting, for each, those
// before it: no branch depends on the data.
inline void sort_by_rank(const float* values, const int32_t* index, size_t count, float* rank,
                         int32_t* sorted) {
  float lanes[kWidth];
  for (size_t c = 0; c < kWidth; ++c) lanes[c] = static_cast<float>(c);
  for (size_t i = 0; i < count; i += kWidth) {
    const Vec value = load(values + i);
    const Vec position = load(lanes) + broadcast(static_cast<float>(i));
    Vec before = broadcast(0.0f), j_position = broadcast(0.0f);
    for (size_t j = 0; j < count; ++j) {
      before = count_before(before, broadcast(values[j]), value, j_position, position);
      j_position = j_position + broadcast(1.0f);
    }
    store(rank + i, before);
  }
  for (size_t i = 0; i < count; ++i) sorted[static_cast<int32_t>(rank[i])] = index[i];
}

void neighbors(const NeighborTask& task) {
  const size_t sources = padded(task.sources, kColumns);
  const size_t m = static_cast<size_t>(task.neighbors) * static_cast<size_t>(task.dilation);
  float* d = task.scratch;
  float* rank = d + sources;  // and, before that, the lowest of each column
  float* values = rank + sources + kColumns;
  int32_t* index = reinterpret_cast<int32_t*>(values + sources + 2 * kColumns);
  int32_t* sorted = index + sources + 2 * kColumns;
  for (size_t q = 0; q < task.queries; ++q) {
    const Vec x = broadcast(task.x[q]), y = broadcast(task.y[q]), z = broadcast(task.z[q]);
    for (size_t j = 0; j < sources; j += kWidth) {
      const Vec dx = load(task.x + j) - x;
      const Vec dy = load(task.y + j) - y;
      const Vec dz = load(task.z + j) - z;
      store(d + j, dx * dx + dy * dy + dz * dz);
    }
    const float bound = bound_of_nearest(d, sources, m, rank);
    const size_t count = compress(d, sources, bound, values, index);
    for (size_t c = 0; c < kColumns; ++c) values[count + c] = __builtin_inff();
    sort_by_rank(values, index, count, rank, sorted);
    uint16_t* result = task.result + q * static_cast<size_t>(task.neighbors);
    for (int k = 0; k < task.neighbors; ++k) {
      result[k] = static_cast<uint16_t>(sorted[k * task.dilation]);
    }
  }
}

}  // namespace
}  // namespace SEGLOC_ISA
}  // namespace segloc
