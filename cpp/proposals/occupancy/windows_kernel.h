// The loop that scores windows side by side.
#pragma once

#include "simd/kernels.h"
#include "simd/simd.h"

namespace segloc {
namespace SEGLOC_ISA {
namespace {

SEGLOC_VECTOR(uint8_t, Windows, kWindowRun);

constexpr size_t kRunsTogether = 4;  // their sums stay in registers
constexpr size_t kColumnsInByte = 31;

void add_slices(const uint8_t* image, const size_t* columns, const uint8_t* slices, size_t count,
                const size_t* runs, size_t run_count, uint16_t* sums) {
  for (size_t run = 0; run < run_count; run += kRunsTogether) {
    const size_t few = run_count - run < kRunsTogether ? run_count - run : kRunsTogether;
    size_t at[kRunsTogether];
    for (size_t j = 0; j < kRunsTogether; ++j) at[j] = runs[run + (j < few ? j : 0)];
    for (size_t begin = 0; begin < count; begin += kColumnsInByte) {
      const size_t end = count - begin < kColumnsInByte ? count : begin + kColumnsInByte;
      Windows sum[kRunsTogether] = {};
      for (size_t i = begin; i < end; ++i) {
        SEGLOC_UNROLL
        for (size_t j = 0; j < kRunsTogether; ++j) {
          Windows v;
          copy_bytes(&v, image + (columns[i] + at[j]), sizeof(v));
          v &= slices[i];
          v -= (v >> 1) & 0x55;  // the bits of each byte are counted
          v = (v & 0x33) + ((v >> 2) & 0x33);
          sum[j] += (v + (v >> 4)) & 0x0f;
        }
      }
      for (size_t j = 0; j < few; ++j) {
        uint16_t* to = sums + (run + j) * kWindowRun;
        for (size_t w = 0; w < kWindowRun; ++w) to[w] = static_cast<uint16_t>(to[w] + sum[j][w]);
      }
    }
  }
}

}  // namespace
}  // namespace SEGLOC_ISA
}  // namespace segloc
