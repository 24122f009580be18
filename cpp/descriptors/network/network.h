// The descriptor network: X-conv layers over nested point sets, then dense layers. Inference only.
#pragma once

#include <cstddef>
#include <cstdint>
#include <map>
#include <string>
#include <vector>

#include "common/aligned.h"
#include "descriptors/network/xconv.h"
#include "simd/kernels.h"

namespace segloc {

// One row of the layer table.
struct LayerSpec {
  int points;     // N: the layer's points are the first N of the input
  int neighbors;  // K
  int dilation;   // D
  int channels;   // C
};

struct TensorView {
  const float* data;
  std::vector<std::size_t> shape;
};
using Tensors = std::map<std::string, TensorView>;

class Network {
 public:
  // Checks every shape and packs the tensors for the kernels; the views are not kept. Throws
  // std::invalid_argument where a tensor is missing, unknown or of the wrong shape.
  //
  // Tensors, with c the lifted and i the input channels of layer l, o = C, m the depth multiplier:
  //   layers.l.lift1.weight (3, c)      layers.l.lift2.{weight (c, c), bias, scale, shift (c)}
  //   layers.l.x0.weight (3K, K, K)     layers.l.x1.{weight (K, K, K), bias (K, K)}, x2 likewise
  //   layers.l.depthwise.weight (K, c + i, m)
  //   layers.l.pointwise.{weight ((c + i) m, o), scale, shift (o)}
  //   global1.weight (3, g)             global2.{weight (g, g), bias, scale, shift (g)}
  //   fc1.{weight, bias}  fc2.{weight, bias}  fc3.{weight, bias}  quality.{weight (dim, 1), bias}
  Network(const std::vector<LayerSpec>& layers, std::size_t points, const Tensors& tensors,
          Isa isa);

  Network(const Network&) = delete;
  Network& operator=(const Network&) = delete;

  // prepared (segments, points(), 3) in sampling order -> vectors (segments, dim()), quality
  // (segments).
  void describe(const float* prepared, std::size_t segments, int threads, float* vectors,
                float* quality) const;

  // What comes out of one X-conv layer, (segments, N, C): for tests.
  void activations(const float* prepared, std::size_t segments, std::size_t layer,
                   float* output) const;

  std::size_t points() const { return points_; }
  std::size_t dim() const { return dim_; }
  const std::vector<LayerSpec>& layers() const { return specs_; }

 private:
  struct Scratch;

  void run_layer(std::size_t layer, std::size_t segments, Scratch& scratch) const;
  void find_neighbors(std::size_t layer, std::size_t segments, Scratch& scratch) const;
  void head(const float* prepared, std::size_t segments, Scratch& scratch, float* vectors,
            float* quality) const;
  std::size_t sources(std::size_t layer) const;

  const Kernels& kernels_;
  std::vector<LayerSpec> specs_;
  std::size_t points_;
  std::vector<AlignedFloats> memory_;  // the packed weights
  std::vector<XConvWeights> xconv_;
  DenseWeights global1_, global2_, fc1_, fc2_, fc3_, quality_;
  std::size_t global_channels_ = 0;
  std::size_t hidden1_ = 0, hidden2_ = 0;
  std::size_t dim_ = 0;
};

}  // namespace segloc
