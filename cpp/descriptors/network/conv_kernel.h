// Rows of input against panels of weights, where a row's input lies in several pieces: a
// convolution over a grid whose channels are innermost, or, with one piece, a dense layer.
#pragma once

#include "simd/kernels.h"
#include "simd/simd.h"

namespace segloc {
namespace SEGLOC_ISA {
namespace {

constexpr size_t kConvVecs = 2;
constexpr size_t kConvRows = kRegisters / 4;

template <size_t Rows>
inline void conv_rows(const ConvTask& task, size_t first, size_t column) {
  constexpr size_t kColumns = kConvVecs * kWidth;
  const float* panel = task.weight + column * task.weight_rows;
  const float* input[Rows];
  Vec sum[Rows][kConvVecs];
  SEGLOC_UNROLL
  for (size_t r = 0; r < Rows; ++r) {
    SEGLOC_UNROLL
    for (size_t v = 0; v < kConvVecs; ++v) {
      sum[r][v] = load(task.start[first + r] + column + v * kWidth);
    }
  }
  for (size_t p = 0; p < task.pieces; ++p) {
    SEGLOC_UNROLL
    for (size_t r = 0; r < Rows; ++r) input[r] = task.input[first + r] + task.offset[p];
    const float* weight = panel + task.weight_row[p] * kColumns;
    for (size_t i = 0; i < task.length; ++i) {
      Vec w[kConvVecs];
      SEGLOC_UNROLL
      for (size_t v = 0; v < kConvVecs; ++v) w[v] = load(weight + i * kColumns + v * kWidth);
      SEGLOC_UNROLL
      for (size_t r = 0; r < Rows; ++r) {
        const Vec a = broadcast(input[r][i]);
        SEGLOC_UNROLL
        for (size_t v = 0; v < kConvVecs; ++v) sum[r][v] = fma(a, w[v], sum[r][v]);
      }
    }
  }
  SEGLOC_UNROLL
  for (size_t r = 0; r < Rows; ++r) {
    SEGLOC_UNROLL
    for (size_t v = 0; v < kConvVecs; ++v) {
      const Vec value = task.rectify ? max(sum[r][v], broadcast(0.0f)) : sum[r][v];
      store(task.output[first + r] + column + v * kWidth, value);
    }
  }
}

void conv(const ConvTask& task) {
  for (size_t column = task.first_column; column < task.last_column; column += kConvVecs * kWidth) {
    size_t r = 0;
    for (; r + kConvRows <= task.rows; r += kConvRows) conv_rows<kConvRows>(task, r, column);
    for (; r < task.rows; ++r) conv_rows<1>(task, r, column);
  }
}

}  // namespace
}  // namespace SEGLOC_ISA
}  // namespace segloc
