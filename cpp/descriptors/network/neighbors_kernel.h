// Dilated nearest neighbours: for each query the K*D nearest sources, sorted by distance and then
// by index, the query itself included; of these every D-th.
#pragma once

#include "simd/kernels.h"
#include "simd/simd.h"

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
    for (size_t v = 0; v < kVecs; ++v) lowest[r][v] = broadcast(kInfinity);
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
  Vec bound = broadcast(kInfinity);
  for (size_t i = 0; i < Kept * kColumns; i += kWidth) {
    const Vec value = load(low + i);
    Vec count[2] = {broadcast(0.0f), broadcast(0.0f)};  // two chains of additions, not one
    for (size_t j = 0; j < Kept * kColumns; j += 2) {
      count[0] = count_not_above(count[0], broadcast(low[j]), value);
      count[1] = count_not_above(count[1], broadcast(low[j + 1]), value);
    }
    bound = min(bound, choose(count[0] + count[1], rank, value, bound));
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

// Indices of the values up to `bound`, in order. The last block of 16 is filled up with `sources`,
// where d holds infinity.
inline size_t compress(const float* d, size_t sources, float bound, int32_t* index) {
  size_t count = 0;
#if defined(__AVX512F__)
  const __m512 limit = _mm512_set1_ps(bound);
  __m512i lane = _mm512_setr_epi32(0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15);
  for (size_t j = 0; j < sources; j += 16) {
    const __mmask16 mask = _mm512_cmp_ps_mask(_mm512_loadu_ps(d + j), limit, _CMP_LE_OQ);
    _mm512_storeu_si512(index + count, _mm512_maskz_compress_epi32(mask, lane));
    lane = _mm512_add_epi32(lane, _mm512_set1_epi32(16));
    count += count_bits(mask);
  }
#else
  const Vec limit = broadcast(bound);
  for (size_t j = 0; j < sources; j += kWidth) {
    for (uint32_t hits = less_equal(load(d + j), limit); hits != 0; hits &= hits - 1) {
      index[count++] = static_cast<int32_t>(j + lowest_bit(hits));
    }
  }
#endif
  for (size_t c = 0; c < kColumns; ++c) index[count + c] = static_cast<int32_t>(sources);
  return count;
}

inline void gather(const float* d, const int32_t* index, size_t size, float* values) {
#if defined(__AVX512F__)
  for (size_t i = 0; i < size; i += 16) {
    _mm512_storeu_ps(values + i, _mm512_i32gather_ps(_mm512_loadu_si512(index + i), d, 4));
  }
#else
  for (size_t i = 0; i < size; ++i) values[i] = d[index[i]];
#endif
}

// Sorts values by counting, for each, those before it: no branch depends on the data. There is a
// whole number of blocks of 16, so that most searches run the same course.
inline void sort_by_rank(const float* values, const int32_t* index, size_t size, int32_t* rank,
                         int32_t* sorted) {
  float lanes[kWidth];
  for (size_t c = 0; c < kWidth; ++c) lanes[c] = static_cast<float>(c);
  const Vec two = broadcast(2.0f);
  for (size_t i = 0; i < size; i += kWidth) {
    const Vec value = load(values + i);
    const Vec position = load(lanes) + broadcast(static_cast<float>(i));
    Vec before[2] = {broadcast(0.0f), broadcast(0.0f)};
    Vec j_position[2] = {broadcast(0.0f), broadcast(1.0f)};
    for (size_t block = 0; block < size; block += kColumns) {
      SEGLOC_UNROLL
      for (size_t c = 0; c < kColumns; ++c) {
        const size_t chain = c % 2;
        before[chain] = count_before(before[chain], broadcast(values[block + c]), value,
                                     j_position[chain], position);
        j_position[chain] = j_position[chain] + two;
      }
    }
    store_whole(rank + i, before[0] + before[1]);
  }
  for (size_t block = 0; block < size; block += kColumns) {
    SEGLOC_UNROLL
    for (size_t c = 0; c < kColumns; ++c) sorted[rank[block + c]] = index[block + c];
  }
}

void neighbors(const NeighborTask& task) {
  const size_t sources = padded(task.sources, kColumns);
  const size_t m = static_cast<size_t>(task.neighbors) * static_cast<size_t>(task.dilation);
  float* d = task.scratch;
  float* low = d + sources + kColumns;  // the lowest of each column, and later the ranks
  float* values = low + sources + kColumns;
  int32_t* rank = reinterpret_cast<int32_t*>(low);
  int32_t* index = reinterpret_cast<int32_t*>(values + sources + kColumns);
  int32_t* sorted = index + sources + 2 * kColumns;
  for (size_t c = 0; c < kColumns; ++c) d[sources + c] = kInfinity;
  for (size_t q = 0; q < task.queries; ++q) {
    const Vec x = broadcast(task.x[q]), y = broadcast(task.y[q]), z = broadcast(task.z[q]);
    for (size_t j = 0; j < sources; j += kWidth) {
      const Vec dx = load(task.x + j) - x;
      const Vec dy = load(task.y + j) - y;
      const Vec dz = load(task.z + j) - z;
      store(d + j, dx * dx + dy * dy + dz * dz);
    }
    const float bound = bound_of_nearest(d, sources, m, low);
    const size_t size = padded(compress(d, sources, bound, index), kColumns);
    gather(d, index, size, values);
    sort_by_rank(values, index, size, rank, sorted);
    uint16_t* result = task.result + q * static_cast<size_t>(task.neighbors);
    for (int k = 0; k < task.neighbors; ++k) {
      result[k] = static_cast<uint16_t>(sorted[k * task.dilation]);
    }
  }
}

}  // namespace
}  // namespace SEGLOC_ISA
}  // namespace segloc
