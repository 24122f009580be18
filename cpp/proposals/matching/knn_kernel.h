// Scans a block of database points for those that may be among the nearest of a few queries.
#pragma once

#include "simd/kernels.h"
#include "simd/simd.h"

namespace segloc {
namespace SEGLOC_ISA {
namespace {

constexpr size_t kScanQueries = 4;
constexpr size_t kScanVecs = 2;

// at(d, v): values of a block along a dimension; `first` is the index of its first point. Distances
// are sums of squared differences: no cancellation.
template <typename At>
inline void scan_block(const At& at, size_t dim, uint32_t first, KnnScan& scan) {
  constexpr size_t kPoints = kScanVecs * kWidth;
  Vec sum[kScanQueries][kScanVecs];
  SEGLOC_UNROLL
  for (size_t q = 0; q < kScanQueries; ++q) {
    SEGLOC_UNROLL
    for (size_t v = 0; v < kScanVecs; ++v) sum[q][v] = broadcast(0.0f);
  }
  for (size_t d = 0; d < dim; ++d) {
    Vec x[kScanVecs];
    SEGLOC_UNROLL
    for (size_t v = 0; v < kScanVecs; ++v) x[v] = at(d, v);
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
    const Vec threshold = broadcast(scan.thresholds[q]);
    uint32_t hits = 0;
    SEGLOC_UNROLL
    for (size_t v = 0; v < kScanVecs; ++v) {
      hits |= less_equal(sum[q][v], threshold) << (v * kWidth);
    }
    hits &= scan.points;
    if (hits == 0) continue;
    float values[kPoints];
    SEGLOC_UNROLL
    for (size_t v = 0; v < kScanVecs; ++v) store(values + v * kWidth, sum[q][v]);
    for (; hits != 0; hits &= hits - 1) {
      const uint32_t offset = static_cast<uint32_t>(lowest_bit(hits));
      scan.candidates[q][scan.counts[q]] = first + offset;
      scan.distances2[q][scan.counts[q]++] = values[offset];
    }
  }
}

// block: (dim, kScanVecs * kWidth)
void knn_scan(const float* block, size_t dim, uint32_t first, KnnScan& scan) {
  const auto at = [&](size_t d, size_t v) { return load(block + (d * kScanVecs + v) * kWidth); };
  scan_block(at, dim, first, scan);
}

void knn_scan_codes(const KnnCodes& block, size_t dim, uint32_t first, KnnScan& scan) {
  const auto at = [&](size_t d, size_t v) {
    const Vec codes = load_bytes(block.codes + (d * kScanVecs + v) * kWidth);
    return fma(codes, broadcast(block.step[d]), broadcast(block.base[d]));
  };
  scan_block(at, dim, first, scan);
}

// boxes: (kBoxAxes, 2, kBoxRun), lower and upper ends; bounds: squared distances to a place.
void box_bounds(const float* boxes, const float* place, float* bounds) {
  for (size_t first = 0; first < kBoxRun; first += kWidth) {
    Vec sum = broadcast(0.0f);
    SEGLOC_UNROLL
    for (size_t a = 0; a < kBoxAxes; ++a) {
      const float* ends = boxes + 2 * a * kBoxRun + first;
      const Vec at = broadcast(place[a]);
      const Vec gap = max(max(load(ends) - at, at - load(ends + kBoxRun)), broadcast(0.0f));
      sum = fma(gap, gap, sum);
    }
    store(bounds + first, sum);
  }
}

}  // namespace
}  // namespace SEGLOC_ISA
}  // namespace segloc
