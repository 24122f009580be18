// The loop that scores windows side by side.
#pragma once

#include "simd/kernels.h"
#include "simd/simd.h"

namespace segloc {
namespace SEGLOC_ISA {
namespace {

SEGLOC_VECTOR(uint8_t, Windows, kWindowRun);

void add_slices(const uint8_t* image, const size_t* places, size_t count, uint8_t slices,
                uint8_t* sums) {
  for (size_t k = 0; k < count; ++k, sums += kWindowRun) {
    Windows v, sum;
    copy_bytes(&v, image + places[k], sizeof(v));
    copy_bytes(&sum, sums, sizeof(sum));
    v &= slices;
    v -= (v >> 1) & 0x55;  // the bits of each byte are counted
    v = (v & 0x33) + ((v >> 2) & 0x33);
    sum += (v + (v >> 4)) & 0x0f;
    copy_bytes(sums, &sum, sizeof(sum));
  }
}

}  // namespace
}  // namespace SEGLOC_ISA
}  // namespace segloc
