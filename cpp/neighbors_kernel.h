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

// An upper bound for the m-th smallest of d: the m-th smallest among the `kept` lowest of each
// column (d[j] is in column j % 16). Few sources lie below it, so few need sorting.
inline float rank_bound(const float* d, size_t sources, size_t m, size_t kept, float* low) {
  for (size_t i = 0; i < kept * kColumns; ++i) low[i] = d[i];
  for (size_t r = 1; r < kept; ++r) {  // sort the columns of the first rows, downwards
    for (size_t s = r; s > 0; --s) {
      for (size_t c = 0; c < kColumns; c += kWidth) {
        float* above = low + (s - 1) * kColumns + c;
        const Vec a = load(above), b = load(above + kColumns);
        store(above, min(a, b));
        store(above + kColumns, max(a, b));
      }
    }
  }
  for (size_t j = kept * kColumns; j < sources; j += kColumns) {
    for (size_t c = 0; c < kColumns; c += kWidth) {
      Vec t = load(d + j + c);
      for (size_t r = 0; r < kept; ++r) {
        float* slot = low + r * kColumns + c;
        const Vec a = load(slot);
        store(slot, min(a, t));
        t = max(a, t);
      }
    }
  }
  // The m-th smallest is the least value with at least m values not above it.
  float bound = __builtin_inff();
  const size_t count = kept * kColumns;
  for (size_t i = 0; i < count; i += kColumns) {
    int32_t rank[kColumns] = {};
    for (size_t j = 0; j < count; ++j) {
      for (size_t c = 0; c < kColumns; ++c) rank[c] += low[j] <= low[i + c];
    }
    for (size_t c = 0; c < kColumns; ++c) {
      const float value = rank[c] >= static_cast<int32_t>(m) ? low[i + c] : __builtin_inff();
      bound = value < bound ? value : bound;
    }
  }
  return bound;
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
inline void sort_by_rank(const float* values, const int32_t* index, size_t count, int32_t* sorted) {
  for (size_t i = 0; i < count; i += kColumns) {
    int32_t rank[kColumns] = {};
    for (size_t j = 0; j < count; ++j) {
      const float v = values[j];
      const int32_t position = static_cast<int32_t>(j) - static_cast<int32_t>(i);
      for (size_t c = 0; c < kColumns; ++c) {
        rank[c] += (v < values[i + c]) | ((v == values[i + c]) & (position < static_cast<int>(c)));
      }
    }
    const size_t valid = count - i < kColumns ? count - i : kColumns;
    for (size_t c = 0; c < valid; ++c) sorted[rank[c]] = index[i + c];
  }
}

void neighbors(const NeighborTask& task) {
  const size_t sources = padded(task.sources, kColumns);
  const size_t m = static_cast<size_t>(task.neighbors) * static_cast<size_t>(task.dilation);
  const size_t kept = m / 12 + 1;
  float* d = task.scratch;
  float* low = d + sources;
  float* values = low + sources;
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
    const bool all = kept * kColumns >= sources;
    const float bound = all ? kLargest : rank_bound(d, sources, m, kept, low);
    const size_t count = compress(d, sources, bound, values, index);
    for (size_t c = 0; c < kColumns; ++c) values[count + c] = __builtin_inff();
    sort_by_rank(values, index, count, sorted);
    uint16_t* result = task.result + q * static_cast<size_t>(task.neighbors);
    for (int k = 0; k < task.neighbors; ++k) {
      result[k] = static_cast<uint16_t>(sorted[k * task.dilation]);
    }
  }
}

}  // namespace
}  // namespace SEGLOC_ISA
}  // namespace segloc
