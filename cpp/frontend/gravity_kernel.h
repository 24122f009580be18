// How many normals agree with a direction.
#pragma once

#include "simd/kernels.h"
#include "simd/simd.h"

namespace segloc {
namespace SEGLOC_ISA {
namespace {

// No fused products, and the sum in parts: every instruction set finds the same scores.
void agreements(const PointArrays& normals, size_t count, const double* directions,
                size_t direction_count, float slope, double* scores) {
  constexpr size_t kLanes = 16;
  const Vec one = broadcast(1.0f), zero = broadcast(0.0f), steep = broadcast(slope);
  for (size_t k = 0; k < direction_count; ++k) {
    const Vec x = broadcast(static_cast<float>(directions[3 * k]));
    const Vec y = broadcast(static_cast<float>(directions[3 * k + 1]));
    const Vec z = broadcast(static_cast<float>(directions[3 * k + 2]));
    Vec part[kLanes / kWidth];
    SEGLOC_UNROLL
    for (size_t v = 0; v < kLanes / kWidth; ++v) part[v] = zero;
    for (size_t i = 0; i < count; i += kLanes) {
      SEGLOC_UNROLL
      for (size_t v = 0; v < kLanes / kWidth; ++v) {
        const size_t at = i + v * kWidth;
        const Vec along =
            load(normals.x + at) * x + load(normals.y + at) * y + load(normals.z + at) * z;
        const Vec squared = along * along;
        const Vec nearest = min(squared, one - squared);  // sine to either, squared
        part[v] = part[v] + max(one - nearest * steep, zero);
      }
    }
    float parts[kLanes];
    SEGLOC_UNROLL
    for (size_t v = 0; v < kLanes / kWidth; ++v) store(parts + v * kWidth, part[v]);
    double score = 0.0;
    for (size_t lane = 0; lane < kLanes; ++lane) score += static_cast<double>(parts[lane]);
    scores[k] = score;
  }
}

}  // namespace
}  // namespace SEGLOC_ISA
}  // namespace segloc
