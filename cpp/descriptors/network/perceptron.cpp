#include "descriptors/network/perceptron.h"

#include <algorithm>

#include "common/parallel.h"
#include "descriptors/network/network_pack.h"

namespace segloc {
namespace {

constexpr std::size_t kBatch = 32;  // rows that use each weight while it is in cache

}  // namespace

Perceptron::Perceptron(const Tensors& tensors, float limit, Isa isa)
    : kernels_(kernels(isa)), limit_(limit) {
  WeightPacker packer(tensors, kernels_);
  inputs_ = packer.extent("input.mean", 0);
  const float* mean = packer.get("input.mean", {inputs_});
  const float* scale = packer.get("input.scale", {inputs_});
  mean_.assign(mean, mean + inputs_);
  scale_.assign(scale, scale + inputs_);
  std::size_t width = inputs_;
  widest_ = padded(inputs_, kChannelPad);
  for (std::size_t l = 0; tensors.count("hidden." + std::to_string(l) + ".weight"); ++l) {
    const std::string name = "hidden." + std::to_string(l);
    const std::size_t outputs = packer.extent(name + ".weight", 1);
    layers_.push_back(packer.dense(name, width, outputs, true, true, true));
    width = outputs;
    widest_ = std::max(widest_, padded(width, kernels_.panel));
  }
  outputs_ = packer.extent("output.weight", 1);
  layers_.push_back(packer.dense("output", width, outputs_, false, true, false));
  widest_ = std::max(widest_, padded(outputs_, kernels_.panel));
  memory_ = packer.finish();
}

void Perceptron::run(const float* input, std::size_t rows, int threads, float* output) const {
  const std::size_t batches = (rows + kBatch - 1) / kBatch;
  parallel_for(batches, 1, threads, [&](std::size_t begin, std::size_t end, int) {
    AlignedFloats current(kBatch * widest_), next(kBatch * widest_);
    for (std::size_t b = begin; b < end; ++b) {
      const std::size_t first = b * kBatch, count = std::min(kBatch, rows - first);
      for (std::size_t r = 0; r < count; ++r) {
        const float* row = input + (first + r) * inputs_;
        for (std::size_t i = 0; i < inputs_; ++i) {
          const float value = (row[i] - mean_[i]) * scale_[i];
          current[r * widest_ + i] = std::clamp(value, -limit_, limit_);
        }
      }
      for (const DenseWeights& layer : layers_) {
        kernels_.dense(layer, current.data(), widest_, count, next.data(), widest_);
        std::swap(current, next);
      }
      for (std::size_t r = 0; r < count; ++r) {
        std::copy_n(current.data() + r * widest_, outputs_, output + (first + r) * outputs_);
      }
    }
  });
}

}  // namespace segloc
