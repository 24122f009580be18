// The tensors of the voxel network, packed for the kernels, and what it gives for an empty grid.
#include <algorithm>
#include <array>
#include <stdexcept>
#include <string>

#include "descriptors/network/voxel_columns.h"
#include "descriptors/network/voxel_network.h"
#include "descriptors/network/voxel_scratch.h"

namespace segloc {
namespace {

constexpr std::size_t kChannels = 32;  // every number of channels is a multiple
constexpr std::size_t kTaps = 27;

const TensorView& tensor(const Tensors& tensors, const std::string& name) {
  const auto found = tensors.find(name);
  if (found == tensors.end()) throw std::invalid_argument("tensor '" + name + "' is missing");
  return found->second;
}

std::size_t outputs_of(const Tensors& tensors, const std::string& name) {
  const TensorView& weight = tensor(tensors, name + ".weight");
  const std::size_t outputs = weight.shape.empty() ? 0 : weight.shape.back();
  if (outputs == 0 || outputs % kChannels != 0) {
    throw std::invalid_argument("tensor '" + name + ".weight' needs a multiple of 32 outputs");
  }
  return outputs;
}

}  // namespace

VoxelNetwork::Layer VoxelNetwork::packed(const Tensors& tensors, const char* name,
                                         const std::vector<std::size_t>& shape) {
  const std::string weight = std::string(name) + ".weight", bias = std::string(name) + ".bias";
  const TensorView &w = tensor(tensors, weight), &b = tensor(tensors, bias);
  if (w.shape != shape) throw std::invalid_argument("tensor '" + weight + "' has a wrong shape");
  if (b.shape != std::vector<std::size_t>{shape.back()}) {
    throw std::invalid_argument("tensor '" + bias + "' has a wrong shape");
  }
  Layer layer;
  layer.outputs = shape.back();
  layer.inputs = 1;
  for (std::size_t i = 0; i + 1 < shape.size(); ++i) layer.inputs *= shape[i];
  layer.bias = AlignedFloats(layer.outputs);
  std::copy_n(b.data, layer.outputs, layer.bias.data());
  layer.weight = AlignedFloats(layer.inputs * layer.outputs);
  const std::size_t panel = kernels_.panel;
  for (std::size_t i = 0; i < layer.inputs; ++i) {
    for (std::size_t o = 0; o < layer.outputs; ++o) {
      layer.weight[(o / panel * layer.inputs + i) * panel + o % panel] =
          w.data[i * layer.outputs + o];
    }
  }
  return layer;
}

VoxelNetwork::VoxelNetwork(const Tensors& tensors, Isa isa)
    : kernels_(segloc::kernels(isa)),
      a_(outputs_of(tensors, "conv1")),
      b_(outputs_of(tensors, "conv2")),
      c_(outputs_of(tensors, "conv3")),
      hidden_(outputs_of(tensors, "fc1")),
      dim_(outputs_of(tensors, "fc2")),
      features_(kCells2 * c_ + 3) {
  if (tensors.size() != 10) throw std::invalid_argument("a voxel network has ten tensors");
  conv1_ = packed(tensors, "conv1", {3, 3, 3, 1, a_});
  conv2_ = packed(tensors, "conv2", {3, 3, 3, a_, b_});
  conv3_ = packed(tensors, "conv3", {3, 3, 3, b_, c_});
  fc1_ = packed(tensors, "fc1", {features_, hidden_});
  fc2_ = packed(tensors, "fc2", {hidden_, dim_});
  weight1_ = AlignedFloats(kTaps * a_);
  std::copy_n(tensor(tensors, "conv1.weight").data, kTaps * a_, weight1_.data());
  precompute();
}

// What the layers give for an empty grid, which varies only because of the border of zeros.
void VoxelNetwork::precompute() {
  Scratch scratch(*this);
  empty1_ = AlignedFloats(a_);
  for (std::size_t i = 0; i < a_; ++i) empty1_[i] = std::max(conv1_.bias[i], 0.0f);
  for (std::size_t x = 1; x <= kX1; ++x) {
    for (std::size_t y = 1; y <= kY1; ++y) {
      float* column = scratch.delta1.data() + padded_column(x, y, kY1, kZ1) * a_;
      for (std::size_t z = 1; z <= kZ1; ++z) std::copy_n(empty1_.data(), a_, column + z * a_);
    }
  }
  empty2_ = AlignedFloats(kX1 * kY1 * kZ1 * b_);
  Pieces all;
  for (std::size_t d = 0; d < 9; ++d) all.add(d / 3, d % 3, kY1, kZ1, a_);
  std::array<const float*, kZ1> input, start;
  std::array<float*, kZ1> output;
  for (std::size_t column = 0; column < kX1 * kY1; ++column) {
    for (std::size_t z = 0; z < kZ1; ++z) {
      const std::size_t at = padded_column(column / kY1, column % kY1, kY1, kZ1) + z;
      input[z] = scratch.delta1.data() + at * a_;
      start[z] = conv2_.bias.data();
      output[z] = empty2_.data() + (column * kZ1 + z) * b_;
    }
    kernels_.conv({kZ1, input.data(), start.data(), output.data(), all.count, all.offset.data(),
                   all.weight_row.data(), 3 * a_, conv2_.weight.data(), conv2_.inputs, 0, b_,
                   false});
  }
  pooled2_ = AlignedFloats(kCells2 * b_);  // zeros: the least that ReLU gives
  for (std::size_t v = 0; v < kX1 * kY1 * kZ1; ++v) {
    const std::size_t x = v / (kY1 * kZ1) / 2, y = v / kZ1 % kY1 / 2, z = v % kZ1 / 2;
    float* pooled = pooled2_.data() + ((x * kY2 + y) * kZ2 + z) * b_;
    for (std::size_t c = 0; c < b_; ++c) pooled[c] = std::max(pooled[c], empty2_[v * b_ + c]);
  }
  for (std::size_t column = 0; column < kX2 * kY2; ++column) {
    const std::size_t x = column / kY2 + 1, y = column % kY2 + 1;
    std::copy_n(pooled2_.data() + column * kZ2 * b_, kZ2 * b_,
                scratch.delta2.data() + (padded_column(x, y, kY2, kZ2) + 1) * b_);
    scratch.active2[x][y] = true;
  }
  empty3_ = AlignedFloats(kCells2 * c_);
  third(scratch, conv3_.bias.data(), 0, empty3_.data(), false);
}

}  // namespace segloc
