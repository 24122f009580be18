// Coordinates to cells.
#pragma once

#include "simd/kernels.h"
#include "simd/simd.h"

namespace segloc {
namespace SEGLOC_ISA {
namespace {

// The compiler turns it into vectors. A reciprocal would round some places into the next cell.
void cell_numbers(const float* values, size_t count, double size, int32_t* cells) {
  for (size_t i = 0; i < count; ++i) {
    const double at = static_cast<double>(values[i]) / size;
    const auto whole = static_cast<int32_t>(at);
    cells[i] = whole - static_cast<int32_t>(at < static_cast<double>(whole));
  }
}

}  // namespace
}  // namespace SEGLOC_ISA
}  // namespace segloc
