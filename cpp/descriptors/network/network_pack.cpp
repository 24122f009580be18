#include "descriptors/network/network_pack.h"

#include <algorithm>
#include <stdexcept>
#include <utility>

namespace segloc {
namespace {

std::string shape_text(const std::vector<std::size_t>& shape) {
  std::string text = "(";
  for (std::size_t i = 0; i < shape.size(); ++i) {
    text += (i ? ", " : "") + std::to_string(shape[i]);
  }
  return text + ")";
}

// The largest number of rows that divides K and whose sums stay in registers.
std::size_t rows_at_once(std::size_t K, const Kernels& kernels) {
  const std::size_t most = kernels.isa == Isa::avx512 ? 12 : 6;
  for (const std::size_t rows : {12, 10, 8, 6, 5, 4, 3, 2}) {
    if (rows <= most && K % rows == 0) return rows;
  }
  return 1;
}

}  // namespace

float* WeightPacker::allocate(std::size_t size) {
  memory_.emplace_back(size);
  return memory_.back().data();
}

const float* WeightPacker::get(const std::string& name, const std::vector<std::size_t>& shape) {
  const auto found = tensors_.find(name);
  if (found == tensors_.end()) throw std::invalid_argument("tensor '" + name + "' is missing");
  if (found->second.shape != shape) {
    throw std::invalid_argument("tensor '" + name + "' has shape " +
                                shape_text(found->second.shape) + ", expected " +
                                shape_text(shape));
  }
  used_.insert(name);
  return found->second.data;
}

std::size_t WeightPacker::extent(const std::string& name, std::size_t axis) const {
  const auto found = tensors_.find(name);
  if (found == tensors_.end()) throw std::invalid_argument("tensor '" + name + "' is missing");
  const auto& shape = found->second.shape;
  if (shape.size() <= axis || shape[axis] == 0) {
    throw std::invalid_argument("tensor '" + name + "' has shape " + shape_text(shape));
  }
  return shape[axis];
}

std::vector<AlignedFloats> WeightPacker::finish() {
  for (const auto& [name, view] : tensors_) {
    if (used_.count(name) == 0) {
      throw std::invalid_argument("tensor '" + name + "' is not part of this network");
    }
  }
  return std::move(memory_);
}

const float* WeightPacker::vector(const std::string& name, std::size_t count, std::size_t stored) {
  const float* values = get(name, {count});
  float* packed = allocate(stored);
  std::copy(values, values + count, packed);
  return packed;
}

const float* WeightPacker::constant(std::size_t count, std::size_t stored, float value) {
  float* packed = allocate(stored);
  std::fill(packed, packed + count, value);
  return packed;
}

template <typename Place>
const float* WeightPacker::panels(const float* matrix, std::size_t rows, std::size_t outputs,
                                  std::size_t stored_rows, Place place) {
  const std::size_t panel = kernels_.panel;
  float* packed = allocate(stored_rows * padded(outputs, panel));
  for (std::size_t r = 0; r < rows; ++r) {
    for (std::size_t o = 0; o < outputs; ++o) {
      packed[(o / panel * stored_rows + place(r)) * panel + o % panel] = matrix[r * outputs + o];
    }
  }
  return packed;
}

DenseWeights WeightPacker::dense(const std::string& name, std::size_t inputs, std::size_t outputs,
                                 bool activate, bool biased, bool scaled) {
  const std::size_t stored = padded(outputs, kernels_.panel);
  DenseWeights w;
  w.inputs = inputs;
  w.outputs = stored;
  w.activate = activate;
  w.weight = panels(get(name + ".weight", {inputs, outputs}), inputs, outputs, inputs,
                    [](std::size_t r) { return r; });
  w.bias = biased ? vector(name + ".bias", outputs, stored) : constant(0, stored, 0);
  w.scale = scaled ? vector(name + ".scale", outputs, stored) : constant(outputs, stored, 1);
  w.shift = scaled ? vector(name + ".shift", outputs, stored) : constant(0, stored, 0);
  return w;
}

// Tensor (input row, column of the matrix, output) -> (column, group of outputs, input, output).
const float* WeightPacker::column_maps(const std::string& name, std::size_t K, std::size_t rows) {
  const float* tensor = get(name, {K, K, K});
  float* packed = allocate(K * K * K);
  for (std::size_t c = 0; c < K; ++c) {
    for (std::size_t i = 0; i < K; ++i) {
      for (std::size_t o = 0; o < K; ++o) {
        const std::size_t group = o / rows;
        packed[((c * (K / rows) + group) * K + i) * rows + o % rows] = tensor[(i * K + c) * K + o];
      }
    }
  }
  return packed;
}

DenseWeights WeightPacker::pointwise(const std::string& name, const XConvWeights& layer,
                                     std::size_t inputs, std::size_t outputs) {
  const std::size_t stored = padded(outputs, kernels_.panel);
  const float* matrix = get(name + ".weight", {inputs * layer.depth, outputs});
  DenseWeights w;
  w.inputs = layer.depth * layer.depth_stride;
  w.outputs = stored;
  w.activate = true;
  // The tensor's rows are channel major; the kernel leaves one row of channels per multiple.
  w.weight = panels(matrix, inputs * layer.depth, outputs, w.inputs, [&](std::size_t r) {
    return r % layer.depth * layer.depth_stride + r / layer.depth;
  });
  w.bias = constant(0, stored, 0);
  w.scale = vector(name + ".scale", outputs, stored);
  w.shift = vector(name + ".shift", outputs, stored);
  return w;
}

XConvWeights WeightPacker::xconv(const std::string& name, const LayerSpec& spec,
                                 std::size_t inputs) {
  const auto K = static_cast<std::size_t>(spec.neighbors);
  const std::size_t lifted = extent(name + ".lift1.weight", 1);
  XConvWeights w;
  w.neighbors = spec.neighbors;
  w.lifted = lifted;
  w.lifted_pad = padded(lifted, kChannelPad);
  w.inputs_pad = padded(inputs, kChannelPad);
  w.depth = extent(name + ".depthwise.weight", 2);
  w.depth_stride = inputs == 0 ? w.lifted_pad : lifted + w.inputs_pad;
  w.rows = rows_at_once(K, kernels_);

  const auto matrix = [&](const std::string& tensor, std::size_t rows) {
    const float* values = get(tensor, {rows, lifted});
    float* packed = allocate(rows * w.lifted_pad);
    for (std::size_t r = 0; r < rows; ++r) {
      std::copy(values + r * lifted, values + (r + 1) * lifted, packed + r * w.lifted_pad);
    }
    return packed;
  };
  w.lift1 = matrix(name + ".lift1.weight", 3);
  w.lift2 = matrix(name + ".lift2.weight", lifted);
  w.lift_bias = vector(name + ".lift2.bias", lifted, w.lifted_pad);
  w.lift_scale = vector(name + ".lift2.scale", lifted, w.lifted_pad);
  w.lift_shift = vector(name + ".lift2.shift", lifted, w.lifted_pad);

  const float* x0 = get(name + ".x0.weight", {3 * K, K, K});
  float* x0_packed = allocate(3 * K * K * K);
  for (std::size_t i = 0; i < 3 * K; ++i) {
    for (std::size_t o = 0; o < K * K; ++o) {
      x0_packed[(o / w.rows * 3 * K + i) * w.rows + o % w.rows] = x0[i * K * K + o];
    }
  }
  w.x0 = x0_packed;
  w.x1 = column_maps(name + ".x1.weight", K, w.rows);
  w.x1_bias = get(name + ".x1.bias", {K, K});
  w.x2 = column_maps(name + ".x2.weight", K, w.rows);
  w.x2_bias = get(name + ".x2.bias", {K, K});
  for (const float** bias : {&w.x1_bias, &w.x2_bias}) {
    float* packed = allocate(K * K);
    std::copy(*bias, *bias + K * K, packed);
    *bias = packed;
  }

  const std::size_t channels = lifted + inputs, width = w.lifted_pad + w.inputs_pad;
  const float* depthwise = get(name + ".depthwise.weight", {K, channels, w.depth});
  float* depthwise_packed = allocate(w.depth * K * width);
  for (std::size_t k = 0; k < K; ++k) {
    for (std::size_t c = 0; c < channels; ++c) {
      const std::size_t place = c < lifted ? c : w.lifted_pad + c - lifted;
      for (std::size_t m = 0; m < w.depth; ++m) {
        depthwise_packed[(m * K + k) * width + place] = depthwise[(k * channels + c) * w.depth + m];
      }
    }
  }
  w.depthwise = depthwise_packed;
  w.pointwise =
      pointwise(name + ".pointwise", w, channels, static_cast<std::size_t>(spec.channels));
  return w;
}

}  // namespace segloc
