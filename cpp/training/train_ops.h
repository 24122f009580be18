// The costly operations of training on the CPU, forwards and backwards: the K x K transforms of an
// X-conv layer, and ELU followed by batch norm.
#pragma once

#include <cstddef>
#include <cstdint>

#include "simd/kernels.h"

namespace segloc {

struct ApplyShape {
  std::size_t clouds, points, sources;
  std::size_t neighbors;  // K
  std::size_t lifted, inputs, depth;
  std::size_t channels() const { return lifted + inputs; }
};

// The inputs of one layer. `features` is null where there are no inputs.
struct ApplyInputs {
  const float* x;            // (clouds, points, K, K)
  const float* lift;         // (clouds, points, K, lifted)
  const float* features;     // (clouds, sources, inputs)
  const int64_t* neighbors;  // (clouds, points, K), all below `sources`
  const float* depthwise;    // (depth, K, channels)
};

struct ApplyGradients {
  float* x;
  float* lift;
  float* features;  // added to: zero on entry
  float* depthwise;
};

// output (clouds, points, depth, channels): with F the lifted and gathered features of a point's
// neighbours, output[m][c] = sum_k (X F)[k][c] * depthwise[m][k][c].
void apply_forward(const ApplyShape& shape, const ApplyInputs& in, float* output, Isa isa,
                   int threads);

// From the gradient of the output, those of all inputs. The same for any number of threads.
void apply_backward(const ApplyShape& shape, const ApplyInputs& in, const float* gradient,
                    const ApplyGradients& out, Isa isa, int threads);

// Depthwise maps of (count, K, K) matrices: output[c][o] = sum_i x[i][c] * weight[i][c][o].
void columns_forward(const float* x, const float* weight, std::size_t count, std::size_t K,
                     float* output, Isa isa, int threads);
void columns_backward(const float* x, const float* weight, const float* gradient, std::size_t count,
                      std::size_t K, float* grad_x, float* grad_weight, Isa isa, int threads);

// Batch norm over the columns of (rows, columns), after ELU where `activate` is set.
// Keeps the activated values in `z`; writes mean and biased variance of each column.
void elu_norm_forward(const float* input, std::size_t rows, std::size_t columns, bool activate,
                      const float* weight, const float* bias, float eps, float* z, float* output,
                      float* mean, float* variance, Isa isa, int threads);

// Gradients of the input, the weight and the bias.
void elu_norm_backward(const float* gradient, const float* z, std::size_t rows, std::size_t columns,
                       bool activate, const float* weight, float eps, const float* mean,
                       const float* variance, float* grad_input, float* grad_weight,
                       float* grad_bias, Isa isa, int threads);

}  // namespace segloc
