// Packed weights and per-block buffers of the X-conv and dense kernels. Plain data: the kernels,
// which exist once for each instruction set, see nothing else.
//
// A layer follows Li et al., "PointCNN: Convolution on X-transformed points" (NeurIPS 2018),
// algorithm 1, with each batch norm folded into the following linear map where that is exact, and
// kept as scale and shift where it is not.
#pragma once

#include <cstddef>
#include <cstdint>

namespace segloc {

constexpr std::size_t kChannelPad = 16;  // feature rows are padded with zeros to a multiple

// output = scale * act(input * weight + bias) + shift. Columns come in panels: weight is
// (columns padded to panel / panel, inputs, panel).
struct DenseWeights {
  std::size_t inputs;
  std::size_t outputs;  // padded to the panel; scale and shift are zero beyond the real ones
  bool activate;
  const float* weight;
  const float* bias;
  const float* scale;
  const float* shift;
};

struct XConvWeights {
  int neighbors;             // K
  std::size_t lifted;        // C_delta
  std::size_t lifted_pad;    // padded to kChannelPad
  std::size_t inputs_pad;    // features of the previous layer, padded; 0 in the first layer
  std::size_t depth;         // depth multiplier
  std::size_t depth_stride;  // floats from one multiple to the next in a row of `separated`
  std::size_t rows;          // outputs that the K x K maps compute at a time; divides K
  const float* lift1;        // (3, lifted_pad)
  const float* lift2;        // (lifted, lifted_pad)
  const float* lift_bias;    // (lifted_pad) each
  const float* lift_scale;
  const float* lift_shift;
  const float* x0;       // (K * K / rows, 3 * K, rows)
  const float* x1;       // (K, K / rows, K, rows)
  const float* x1_bias;  // (K, K)
  const float* x2;       // as x1
  const float* x2_bias;
  const float* depthwise;  // (depth, K, lifted_pad + inputs_pad)
  DenseWeights pointwise;  // inputs: depth * depth_stride
};

// One block of up to Kernels::block queries; they may come from several segments.
struct XConvTask {
  std::size_t count;             // queries that are real
  const float* relative;         // (3 * K, block): neighbour minus query, K major
  const float* const* features;  // (block, K): rows of the previous layer
  float* x_a;                    // (K * K, block) each
  float* x_b;
  float* lift_hidden;  // (K, lifted_pad)
  float* lifted;       // (K, lifted_pad)
  float* separated;    // (block, pointwise.inputs + kChannelPad)
  std::size_t separated_stride;
  float* output;  // (count, output_stride)
  std::size_t output_stride;
};

}  // namespace segloc
