// A multi-layer perceptron over rows of standardised numbers. Inference only.
#pragma once

#include <cstddef>
#include <vector>

#include "descriptors/network/network.h"

namespace segloc {

class Perceptron {
 public:
  // Checks every shape and packs the tensors; the views are not kept. Throws
  // std::invalid_argument where a tensor is missing, unknown or of the wrong shape.
  //
  //   input.{mean, scale} (F)     rows enter as (row - mean) * scale, cut to [-limit, limit]
  //   hidden.l.{weight (i, o), bias, scale, shift (o)} of each hidden layer l, from 0
  //   output.{weight (i, o), bias (o)}
  Perceptron(const Tensors& tensors, float limit, Isa isa);

  Perceptron(const Perceptron&) = delete;
  Perceptron& operator=(const Perceptron&) = delete;

  // input (rows, inputs()) -> output (rows, outputs()). A row's output depends on that row alone.
  void run(const float* input, std::size_t rows, int threads, float* output) const;

  std::size_t inputs() const { return inputs_; }
  std::size_t outputs() const { return outputs_; }

 private:
  const Kernels& kernels_;
  float limit_;
  std::size_t inputs_ = 0, outputs_ = 0, widest_ = 0;
  std::vector<AlignedFloats> memory_;
  std::vector<float> mean_, scale_;
  std::vector<DenseWeights> layers_;
};

}  // namespace segloc
