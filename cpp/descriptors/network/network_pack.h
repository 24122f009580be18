// Checks the tensors of a network and packs them for the kernels.
#pragma once

#include <set>
#include <string>
#include <vector>

#include "common/aligned.h"
#include "descriptors/network/network.h"

namespace segloc {

class WeightPacker {
 public:
  WeightPacker(const Tensors& tensors, const Kernels& kernels)
      : tensors_(tensors), kernels_(kernels) {}

  XConvWeights xconv(const std::string& name, const LayerSpec& spec, std::size_t inputs);
  // act(input * weight + bias), and scale and shift after it where they are wanted.
  DenseWeights dense(const std::string& name, std::size_t inputs, std::size_t outputs,
                     bool activate, bool biased, bool scaled);

  const float* get(const std::string& name, const std::vector<std::size_t>& shape);
  std::size_t extent(const std::string& name, std::size_t axis) const;

  // The packed memory; throws if there is a tensor that is not used.
  std::vector<AlignedFloats> finish();

 private:
  float* allocate(std::size_t size);
  const float* vector(const std::string& name, std::size_t count, std::size_t stored);
  const float* constant(std::size_t count, std::size_t stored, float value);
  const float* column_maps(const std::string& name, std::size_t K, std::size_t rows);
  DenseWeights pointwise(const std::string& name, const XConvWeights& layer, std::size_t inputs,
                         std::size_t outputs);
  // A row of the matrix for each of `inputs`, at the position given by `place`.
  template <typename Place>
  const float* panels(const float* matrix, std::size_t rows, std::size_t outputs,
                      std::size_t stored_rows, Place place);

  const Tensors& tensors_;
  const Kernels& kernels_;
  std::set<std::string> used_;
  std::vector<AlignedFloats> memory_;
};

}  // namespace segloc
