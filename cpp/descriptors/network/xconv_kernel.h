// X-conv for a block of queries. Two layouts meet here. The K x K transforms are computed with one
// query a lane, so that any K fills the vectors; everything with channels has one channel a lane.
#pragma once

#include "descriptors/network/xconv.h"
#include "simd/kernels.h"
#include "simd/simd.h"

namespace segloc {
namespace SEGLOC_ISA {
namespace {

constexpr size_t kLaneVecs = 2;  // vectors of queries that share a broadcast weight
constexpr size_t kBlock = kLaneVecs * kWidth;
constexpr size_t kPanelVecs = 2;
constexpr size_t kPanel = kPanelVecs * kWidth;

// `Rows` outputs, one query a lane: output[r] = act(bias[r] + sum_i weight[i][r] * input[i]).
template <size_t Rows>
inline void lane_rows(const float* weight, const float* bias, const float* input, size_t stride,
                      size_t inputs, bool activate, float* output) {
  Vec sum[Rows][kLaneVecs];
  SEGLOC_UNROLL
  for (size_t r = 0; r < Rows; ++r) {
    SEGLOC_UNROLL
    for (size_t v = 0; v < kLaneVecs; ++v) sum[r][v] = broadcast(bias ? bias[r] : 0.0f);
  }
  for (size_t i = 0; i < inputs; ++i) {
    Vec x[kLaneVecs];
    SEGLOC_UNROLL
    for (size_t v = 0; v < kLaneVecs; ++v) x[v] = load(input + i * stride + v * kWidth);
    SEGLOC_UNROLL
    for (size_t r = 0; r < Rows; ++r) {
      const Vec w = broadcast(weight[i * Rows + r]);
      SEGLOC_UNROLL
      for (size_t v = 0; v < kLaneVecs; ++v) sum[r][v] = fma(w, x[v], sum[r][v]);
    }
  }
  SEGLOC_UNROLL
  for (size_t r = 0; r < Rows; ++r) {
    SEGLOC_UNROLL
    for (size_t v = 0; v < kLaneVecs; ++v) {
      store(output + r * kBlock + v * kWidth, activate ? elu(sum[r][v]) : sum[r][v]);
    }
  }
}

// The depthwise (1, K) convolution of a K x K matrix a query: row c of the result comes from
// column c of the input.
template <size_t Rows>
inline void column_maps(const float* weight, const float* bias, const float* input, size_t K,
                        bool activate, float* output) {
  for (size_t c = 0; c < K; ++c) {
    for (size_t r = 0; r < K; r += Rows) {
      lane_rows<Rows>(weight + (c * K + r) * K, bias + c * K + r, input + c * kBlock, K * kBlock, K,
                      activate, output + (c * K + r) * kBlock);
    }
  }
}

// The X-transform of each query, (K * K, block), left in task.x_a.
template <size_t Rows>
inline void transforms(const XConvWeights& w, const XConvTask& task) {
  const size_t K = static_cast<size_t>(w.neighbors);
  for (size_t o = 0; o < K * K; o += Rows) {
    lane_rows<Rows>(w.x0 + o * 3 * K, nullptr, task.relative, kBlock, 3 * K, true,
                    task.x_a + o * kBlock);
  }
  column_maps<Rows>(w.x1, w.x1_bias, task.x_a, K, true, task.x_b);
  column_maps<Rows>(w.x2, w.x2_bias, task.x_b, K, false, task.x_a);
}

// The features that a query's neighbours get from their relative position: (K, lifted_pad).
template <size_t Rows>
inline void lift(const XConvWeights& w, const float* relative, const XConvTask& task) {
  const size_t K = static_cast<size_t>(w.neighbors);
  const size_t stride = w.lifted_pad;
  for (size_t c = 0; c < stride; c += kWidth) {
    const Vec wx = load(w.lift1 + c);
    const Vec wy = load(w.lift1 + stride + c);
    const Vec wz = load(w.lift1 + 2 * stride + c);
    for (size_t k = 0; k < K; ++k) {
      const float* l = relative + 3 * k * kBlock;
      Vec sum = broadcast(l[0]) * wx;
      sum = fma(broadcast(l[kBlock]), wy, sum);
      sum = fma(broadcast(l[2 * kBlock]), wz, sum);
      store(task.lift_hidden + k * stride + c, elu(sum));
    }
  }
  for (size_t c = 0; c < stride; c += kWidth) {
    const Vec scale = load(w.lift_scale + c), shift = load(w.lift_shift + c);
    for (size_t first = 0; first < K; first += Rows) {
      Vec sum[Rows];
      SEGLOC_UNROLL
      for (size_t r = 0; r < Rows; ++r) sum[r] = load(w.lift_bias + c);
      const float* hidden = task.lift_hidden + first * stride;
      for (size_t i = 0; i < w.lifted; ++i) {
        const Vec column = load(w.lift2 + i * stride + c);
        SEGLOC_UNROLL
        for (size_t r = 0; r < Rows; ++r) {
          sum[r] = fma(broadcast(hidden[r * stride + i]), column, sum[r]);
        }
      }
      float* out = task.lifted + first * stride + c;
      SEGLOC_UNROLL
      for (size_t r = 0; r < Rows; ++r) store(out + r * stride, fma(elu(sum[r]), scale, shift));
    }
  }
}

// For one vector of channels: transforms the K rows of features by X, then convolves them over the
// neighbours, without leaving the registers in between.
template <size_t Rows, typename RowOf>
inline void transform_and_separate(const XConvWeights& w, const float* x, RowOf row, size_t channel,
                                   float* output) {
  const size_t K = static_cast<size_t>(w.neighbors);
  const size_t width = w.lifted_pad + w.inputs_pad;
  for (size_t first = 0; first < K; first += Rows) {
    Vec sum[Rows];
    SEGLOC_UNROLL
    for (size_t r = 0; r < Rows; ++r) sum[r] = broadcast(0.0f);
    const float* x_row = x + first * K * kBlock;
    for (size_t n = 0; n < K; ++n) {
      const Vec feature = load(row(n));
      SEGLOC_UNROLL
      for (size_t r = 0; r < Rows; ++r) {
        sum[r] = fma(broadcast(x_row[(r * K + n) * kBlock]), feature, sum[r]);
      }
    }
    for (size_t m = 0; m < w.depth; ++m) {
      const float* weight = w.depthwise + (m * K + first) * width + channel;
      float* out = output + m * w.depth_stride;
      Vec total = first == 0 ? broadcast(0.0f) : load(out);
      SEGLOC_UNROLL
      for (size_t r = 0; r < Rows; ++r) total = fma(load(weight + r * width), sum[r], total);
      store(out, total);
    }
  }
}

// Rows of the input against one panel of columns.
template <size_t Rows>
inline void dense_rows(const DenseWeights& w, const float* weight, size_t column,
                       const float* input, size_t input_stride, float* output,
                       size_t output_stride) {
  Vec sum[Rows][kPanelVecs];
  SEGLOC_UNROLL
  for (size_t r = 0; r < Rows; ++r) {
    SEGLOC_UNROLL
    for (size_t v = 0; v < kPanelVecs; ++v) sum[r][v] = load(w.bias + column + v * kWidth);
  }
  for (size_t i = 0; i < w.inputs; ++i) {
    Vec b[kPanelVecs];
    SEGLOC_UNROLL
    for (size_t v = 0; v < kPanelVecs; ++v) b[v] = load(weight + i * kPanel + v * kWidth);
    SEGLOC_UNROLL
    for (size_t r = 0; r < Rows; ++r) {
      const Vec a = broadcast(input[r * input_stride + i]);
      SEGLOC_UNROLL
      for (size_t v = 0; v < kPanelVecs; ++v) sum[r][v] = fma(a, b[v], sum[r][v]);
    }
  }
  SEGLOC_UNROLL
  for (size_t v = 0; v < kPanelVecs; ++v) {
    const size_t c = column + v * kWidth;
    if (c >= output_stride) break;
    const Vec scale = load(w.scale + c), shift = load(w.shift + c);
    SEGLOC_UNROLL
    for (size_t r = 0; r < Rows; ++r) {
      const Vec value = w.activate ? elu(sum[r][v]) : sum[r][v];
      store(output + r * output_stride + c, fma(value, scale, shift));
    }
  }
}

void dense(const DenseWeights& w, const float* input, size_t input_stride, size_t rows,
           float* output, size_t output_stride) {
  constexpr size_t kRows = kRegisters / 4;
  for (size_t column = 0; column < w.outputs; column += kPanel) {
    const float* weight = w.weight + column * w.inputs;
    size_t r = 0;
    for (; r + kRows <= rows; r += kRows) {
      dense_rows<kRows>(w, weight, column, input + r * input_stride, input_stride,
                        output + r * output_stride, output_stride);
    }
    for (; r < rows; ++r) {
      dense_rows<1>(w, weight, column, input + r * input_stride, input_stride,
                    output + r * output_stride, output_stride);
    }
  }
}

template <size_t Rows>
void xconv_block(const XConvWeights& w, const XConvTask& task) {
  transforms<Rows>(w, task);
  const size_t K = static_cast<size_t>(w.neighbors);
  for (size_t q = 0; q < task.count; ++q) {
    lift<Rows>(w, task.relative + q, task);
    const float* x = task.x_a + q;
    float* output = task.separated + q * task.separated_stride;
    for (size_t c = 0; c < w.lifted_pad; c += kWidth) {
      const auto row = [&](size_t n) { return task.lifted + n * w.lifted_pad + c; };
      transform_and_separate<Rows>(w, x, row, c, output + c);
    }
    const float* const* features = task.features + q * K;
    for (size_t c = 0; c < w.inputs_pad; c += kWidth) {
      const auto row = [&](size_t n) { return features[n] + c; };
      transform_and_separate<Rows>(w, x, row, w.lifted_pad + c, output + w.lifted + c);
    }
  }
  dense(w.pointwise, task.separated, task.separated_stride, task.count, task.output,
        task.output_stride);
}

void xconv(const XConvWeights& w, const XConvTask& task) {
  switch (w.rows) {
    case 12:
      return xconv_block<12>(w, task);
    case 10:
      return xconv_block<10>(w, task);
    case 8:
      return xconv_block<8>(w, task);
    case 6:
      return xconv_block<6>(w, task);
    case 5:
      return xconv_block<5>(w, task);
    case 4:
      return xconv_block<4>(w, task);
    case 3:
      return xconv_block<3>(w, task);
    case 2:
      return xconv_block<2>(w, task);
    default:
      return xconv_block<1>(w, task);
  }
}

}  // namespace
}  // namespace SEGLOC_ISA
}  // namespace segloc
