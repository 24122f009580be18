// The search of the consensus for the matches near a pose.
#pragma once

#include "simd/kernels.h"
#include "simd/simd.h"

namespace segloc {
namespace SEGLOC_ISA {
namespace {

// No fused products here: every instruction set must find the same pairs.
inline size_t append(uint32_t hits, size_t first, size_t end, uint32_t* found, size_t count) {
  if (end - first < kWidth) hits &= (1u << (end - first)) - 1u;
  for (; hits != 0; hits &= hits - 1) {
    found[count++] = static_cast<uint32_t>(first) + static_cast<uint32_t>(lowest_bit(hits));
  }
  return count;
}

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
