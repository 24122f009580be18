// The loop that scores windows side by side.
#pragma once

#include "simd/kernels.h"
#include "simd/simd.h"

namespace segloc {
namespace SEGLOC_ISA {
namespace {

SEGLOC_VECTOR(uint8_t, Windows, kWindowRun);
SEGLOC_VECTOR(uint16_t, WindowSums, 2 * kWindowRun);

constexpr size_t kRunsTogether = 2;  // their sums stay in registers
constexpr size_t kAdded = 8, kAddedInByte = 31 * kAdded;

// The number of bits of each byte.
inline Windows ones(Windows v) {
  v -= (v >> 1) & 0x55;
  v = (v & 0x33) + ((v >> 2) & 0x33);
  return (v + (v >> 4)) & 0x0f;
}

// Bits of one weight: keeps the sum's lowest bit, and returns its carry.
inline Windows add(Windows& sum, Windows a, Windows b) {
  const Windows differ = sum ^ a, carry = (sum & a) | (differ & b);
  sum = differ ^ b;
  return carry;
}

// Eight columns are added bit by bit before the bits of their sums are counted, as in W. Mula,
// N. Kurz, D. Lemire, "Faster population counts using AVX2 instructions", 2018.
void add_slices(const uint8_t* image, const size_t* columns, const uint8_t* slices, size_t count,
                const size_t* runs, size_t run_count, uint16_t* sums) {
  for (size_t begin = 0; begin < count; begin += kAddedInByte) {  // neighbouring runs share lines
    const size_t end = count - begin < kAddedInByte ? count : begin + kAddedInByte;
    for (size_t run = 0; run < run_count; run += kRunsTogether) {
      const size_t few = run_count - run < kRunsTogether ? run_count - run : kRunsTogether;
      const uint8_t* from[kRunsTogether];
      for (size_t j = 0; j < kRunsTogether; ++j) from[j] = image + runs[run + (j < few ? j : 0)];
      const auto held = [&](size_t j, size_t i) {
        Windows v;
        copy_bytes(&v, from[j] + columns[i], sizeof(v));
        return v & slices[i];
      };
      Windows one[kRunsTogether] = {}, two[kRunsTogether] = {}, four[kRunsTogether] = {},
              eights[kRunsTogether] = {}, rest[kRunsTogether] = {};
      size_t i = begin;
      for (; i + kAdded <= end; i += kAdded) {
        SEGLOC_UNROLL
        for (size_t j = 0; j < kRunsTogether; ++j) {
          const Windows a = add(one[j], held(j, i), held(j, i + 1));
          const Windows b = add(one[j], held(j, i + 2), held(j, i + 3));
          const Windows c = add(two[j], a, b);
          const Windows d = add(one[j], held(j, i + 4), held(j, i + 5));
          const Windows e = add(one[j], held(j, i + 6), held(j, i + 7));
          eights[j] += ones(add(four[j], c, add(two[j], d, e)));
        }
      }
      for (; i < end; ++i) {
        for (size_t j = 0; j < kRunsTogether; ++j) rest[j] += ones(held(j, i));
      }
      for (size_t j = 0; j < few; ++j) {
        uint16_t* to = sums + (run + j) * kWindowRun;
        rest[j] += ones(one[j]) + 2 * ones(two[j]) + 4 * ones(four[j]);
        WindowSums sum;
        copy_bytes(&sum, to, sizeof(sum));
        sum += 8 * SEGLOC_CONVERT(eights[j], WindowSums);
        sum += SEGLOC_CONVERT(rest[j], WindowSums);
        copy_bytes(to, &sum, sizeof(sum));
      }
    }
  }
}

}  // namespace
}  // namespace SEGLOC_ISA
}  // namespace segloc
