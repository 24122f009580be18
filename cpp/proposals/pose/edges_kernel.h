// The search for pairs whose edges to one pair are about as long in the source as in the target.
#pragma once

#include "proposals/pose/consensus_kernel.h"
#include "simd/kernels.h"
#include "simd/simd.h"

namespace segloc {
namespace SEGLOC_ISA {
namespace {

// |sqrt(a) - sqrt(b)| <= r, without roots: a + b - r^2 is negative, or its square at most 4 a b.
size_t like_edges(const EdgeArrays& f, size_t k, float tolerance, size_t begin, size_t end,
                  uint32_t* found) {
  const Vec x = broadcast(f.source[0][k]), y = broadcast(f.source[1][k]);
  const Vec z = broadcast(f.source[2][k]), u = broadcast(f.target[0][k]);
  const Vec v = broadcast(f.target[1][k]), w = broadcast(f.target[2][k]);
  const Vec r2 = broadcast(tolerance * tolerance), zero = broadcast(0.0f), four = broadcast(4.0f);
  size_t count = 0;
  for (size_t i = begin; i < end; i += kWidth) {
    const Vec dx = load(f.source[0] + i) - x, dy = load(f.source[1] + i) - y;
    const Vec dz = load(f.source[2] + i) - z, du = load(f.target[0] + i) - u;
    const Vec dv = load(f.target[1] + i) - v, dw = load(f.target[2] + i) - w;
    const Vec a = dx * dx + dy * dy + dz * dz, b = du * du + dv * dv + dw * dw;
    const Vec rest = a + b - r2;
    const uint32_t hits = less_equal(rest, zero) | less_equal(rest * rest, four * a * b);
    if (hits != 0) count = append(hits, i, end, found, count);
  }
  return count;
}

}  // namespace
}  // namespace SEGLOC_ISA
}  // namespace segloc
