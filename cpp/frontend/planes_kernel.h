// The search for the neighbours of a place.
#pragma once

#include "simd/kernels.h"
#include "simd/simd.h"

namespace segloc {
namespace SEGLOC_ISA {
namespace {

// No fused products here: every instruction set must find the same points.
size_t near_points(const PointArrays& points, const float* place, float distance2, size_t begin,
                   size_t end, uint32_t* found) {
  const Vec x = broadcast(place[0]), y = broadcast(place[1]), z = broadcast(place[2]);
  const Vec limit = broadcast(distance2);
  size_t count = 0;
  for (size_t i = begin; i < end; i += kWidth) {
    const Vec dx = load(points.x + i) - x, dy = load(points.y + i) - y;
    const Vec dz = load(points.z + i) - z;
    uint32_t hits = less_equal(dx * dx + dy * dy + dz * dz, limit);
    if (end - i < size_t{kWidth}) hits &= (1u << (end - i)) - 1u;
    count = append_fast(hits, i, found, count);
  }
  return count;
}

}  // namespace
}  // namespace SEGLOC_ISA
}  // namespace segloc
