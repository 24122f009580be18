// Scans a tile of database points for those that may be among the nearest of a few queries.
#pragma once

#include "simd/kernels.h"
#include "simd/simd.h"

namespace segloc {
namespace SEGLOC_ISA {
namespace {

constexpr size_t kScanQueries = 4;
constexpr size_t kScanVecs = 2;

// tile: (blocks, dim, kScanVecs * kWidth); `first` is the index of its first point. Distances are
// sums of squared differences: no cancellation.
void knn_scan(const float* tile, size_t blocks, size_t dim, uint32_t first, KnnScan& scan) {
  constexpr size_t kPoints = kScanVecs * kWidth;
  Vec threshold[kScanQueries];
  SEGLOC_UNROLL
  for (size_t q = 0; q < kScanQueries; ++q) threshold[q] = broadcast(scan.thresholds[q]);
  for (size_t block = 0; block < blocks; ++block) {
    const float* points = tile + block * dim * kPoints;
    Vec sum[kScanQueries][kScanVecs];
    SEGLOC_UNROLL
    for (size_t q = 0; q < kScanQueries; ++q) {
      SEGLOC_UNROLL
      for (size_t v = 0; v < kScanVecs; ++v) sum[q][v] = broadcast(0.0f);
    }
    for (size_t d = 0; d < dim; ++d) {
      Vec x[kScanVecs];
      SEGLOC_UNROLL
      for (size_t v = 0; v < kScanVecs; ++v) x[v] = load(points + d * kPoints + v * kWidth);
      SEGLOC_UNROLL
      for (size_t q = 0; q < kScanQueries; ++q) {
        const Vec y = broadcast(scan.queries[q][d]);
        SEGLOC_UNROLL
        for (size_t v = 0; v < kScanVecs; ++v) {
          const Vec difference = x[v] - y;
          sum[q][v] = fma(difference, difference, sum[q][v]);
        }
      }
    }
    SEGLOC_UNROLL
    for (size_t q = 0; q < kScanQueries; ++q) {
      uint32_t hits = 0;
      SEGLOC_UNROLL
      for (size_t v = 0; v < kScanVecs; ++v) {
        hits |= less_equal(sum[q][v], threshold[q]) << (v * kWidth);
      }
      if (hits == 0) continue;
      float values[kPoints];
      SEGLOC_UNROLL
      for (size_t v = 0; v < kScanVecs; ++v) store(values + v * kWidth, sum[q][v]);
      const uint32_t index = first + static_cast<uint32_t>(block * kPoints);
      for (; hits != 0; hits &= hits - 1) {
        const uint32_t offset = static_cast<uint32_t>(lowest_bit(hits));
        scan.candidates[q][scan.counts[q]] = index + offset;
        scan.distances2[q][scan.counts[q]++] = values[offset];
      }
    }
  }
}

}  // namespace
}  // namespace SEGLOC_ISA
}  // namespace segloc
