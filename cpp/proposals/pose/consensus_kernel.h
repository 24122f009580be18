// The search of the consensus for the matches near a pose.
#pragma once

#include "simd/kernels.h"
#include "simd/simd.h"

namespace segloc {
namespace SEGLOC_ISA {
namespace {

// No fused products here: every instruction set must find the same pairs.
size_t near_pose(const MatchArrays& f, const PoseTest& test, size_t begin, size_t end,
                 uint32_t* found) {
  const Vec c = broadcast(test.cosine), s = broadcast(test.sine);
  const Vec tx = broadcast(test.x), ty = broadcast(test.y), limit = broadcast(test.max_distance2);
  size_t count = 0;
  for (size_t i = begin; i < end; i += kWidth) {
    const Vec x = load(f.qx + i), y = load(f.qy + i);
    const Vec dx = (c * x - s * y) + (tx - load(f.mx + i));
    const Vec dy = (s * x + c * y) + (ty - load(f.my + i));
    const uint32_t hits = less_equal(dx * dx + dy * dy, limit);
    if (hits != 0) count = append(hits, i, end, found, count);
  }
  return count;
}

}  // namespace
}  // namespace SEGLOC_ISA
}  // namespace segloc
