// SegMap's descriptor network (Dubé et al., RSS 2018): three convolutions over an occupancy grid,
// two dense layers. Inference only.
#pragma once

#include <cstddef>
#include <cstdint>
#include <vector>

#include "common/aligned.h"
#include "descriptors/network/network.h"
#include "descriptors/voxel_shape.h"
#include "simd/kernels.h"

namespace segloc {

// A segment leaves most of its grid empty. In empty parts the layers give the values of an empty
// grid, which are computed once. A convolution runs over the differences to these, for the columns
// with any. The result is the same up to rounding.
class VoxelNetwork {
 public:
  // Tensors, with channels a, b, c and h that are multiples of 32:
  //   conv1.weight (3, 3, 3, 1, a)  conv2.weight (3, 3, 3, a, b)  conv3.weight (3, 3, 3, b, c)
  //   fc1.weight (8 * 8 * 4 * c + 3, h)  fc2.weight (h, dim)  and a bias for each.
  // ReLU follows each layer, and pooling over 2 x 2 x 2 voxels conv1 and conv2; the grid is padded
  // with zeros. The first dense layer reads the last features by x, y, z and channel, then the
  // scales of the segment. Throws std::invalid_argument for tensors that do not fit.
  VoxelNetwork(const Tensors& tensors, Isa isa);

  VoxelNetwork(const VoxelNetwork&) = delete;
  VoxelNetwork& operator=(const VoxelNetwork&) = delete;

  std::size_t dim() const { return dim_; }

  // voxels of all segments with their offsets (segments + 1), scales (segments, 3) -> vectors
  // (segments, dim()). The numbers must be below kShapeVoxels.
  void describe(const int32_t* voxels, const int64_t* offsets, const float* scales,
                std::size_t segments, int threads, float* vectors) const;

 private:
  struct Layer {
    std::size_t inputs = 0, outputs = 0;
    AlignedFloats weight, bias;  // weight: (panels, inputs, panel)
  };
  struct Scratch;

  Layer packed(const Tensors& tensors, const char* name, const std::vector<std::size_t>& shape);
  void precompute();
  void first(const int32_t* voxels, std::size_t count, Scratch& scratch) const;
  void second(Scratch& scratch) const;
  void third(Scratch& scratch, const float* sums, std::size_t stride, float* features,
             bool rectify) const;
  void dense(const Layer& layer, const float* input, std::size_t stride, std::size_t rows,
             int threads, float* output) const;

  const Kernels& kernels_;
  std::size_t a_, b_, c_, hidden_, dim_, features_;
  AlignedFloats weight1_;  // (27, a)
  AlignedFloats empty1_;   // (a): a pooled cell of an empty grid
  AlignedFloats empty2_;   // (16, 16, 8, b): sums of conv2 over an empty grid
  AlignedFloats pooled2_;  // (8, 8, 4, b): after ReLU and pooling
  AlignedFloats empty3_;   // (8, 8, 4, c): sums of conv3
  Layer conv1_, conv2_, conv3_, fc1_, fc2_;
};

}  // namespace segloc
