#include "descriptors/network/voxel_network.h"

#include <algorithm>
#include <array>

#include "common/parallel.h"
#include "descriptors/network/voxel_columns.h"
#include "descriptors/network/voxel_scratch.h"

namespace segloc {
namespace {

constexpr std::size_t kBatch = 64;       // segments whose features wait for the dense layers
constexpr std::size_t kDenseRows = 512;  // inputs of a dense layer whose weights stay in cache

void pool(const float* values, std::size_t stride, std::size_t channels, float* output) {
  std::copy_n(values, channels, output);
  for (std::size_t i = 1; i < 8; ++i) {
    const float* other = values + i * stride;
    for (std::size_t c = 0; c < channels; ++c) output[c] = std::max(output[c], other[c]);
  }
}

}  // namespace

// Occupancy -> differences of the pooled first layer to those of an empty grid.
void VoxelNetwork::first(const int32_t* voxels, std::size_t count, Scratch& scratch) const {
  // Bit z + 1 of a column, with a border of one.
  std::array<std::array<uint32_t, kShapeSize[1] + 2>, kShapeSize[0] + 2> columns{};
  for (std::size_t i = 0; i < count; ++i) {
    const auto v = static_cast<std::size_t>(voxels[i]);
    const std::size_t column = v / kShapeSize[2];
    columns[column / kShapeSize[1] + 1][column % kShapeSize[1] + 1] |= 2u << v % kShapeSize[2];
  }
  for (std::size_t x = 0; x < kX1; ++x) {
    for (std::size_t y = 0; y < kY1; ++y) {
      uint32_t any = 0;
      for (std::size_t d = 0; d < 16; ++d) any |= columns[2 * x + d / 4][2 * y + d % 4];
      if (any == 0) continue;
      scratch.active1[x + 1][y + 1] = true;
      for (std::size_t z = 0; z < kZ1; ++z) {
        if ((any >> 2 * z & 15) == 0) continue;
        float* cell = scratch.cell.data();  // the 2 x 2 x 2 outputs that are pooled
        for (std::size_t o = 0; o < 8; ++o) std::copy_n(conv1_.bias.data(), a_, cell + o * a_);
        for (std::size_t d = 0; d < 64; ++d) {
          const std::size_t dx = d / 16, dy = d / 4 % 4, dz = d % 4;
          if ((columns[2 * x + dx][2 * y + dy] >> (2 * z + dz) & 1) == 0) continue;
          for (std::size_t o = 0; o < 8; ++o) {
            const std::size_t tx = dx - o / 4, ty = dy - o / 2 % 2, tz = dz - o % 2;
            if (tx > 2 || ty > 2 || tz > 2) continue;  // also where one is below zero
            const float* weight = weight1_.data() + ((tx * 3 + ty) * 3 + tz) * a_;
            for (std::size_t c = 0; c < a_; ++c) cell[o * a_ + c] += weight[c];
          }
        }
        float* out = scratch.delta1.data() + (padded_column(x + 1, y + 1, kY1, kZ1) + z + 1) * a_;
        pool(cell, a_, a_, out);
        for (std::size_t c = 0; c < a_; ++c) out[c] = std::max(out[c], 0.0f) - empty1_[c];
      }
    }
  }
}

// -> differences of the pooled second layer.
void VoxelNetwork::second(Scratch& scratch) const {
  std::array<const float*, kZ1> input, start;
  std::array<float*, kZ1> output;
  for (std::size_t cell = 0; cell < kX2 * kY2; ++cell) {
    const std::size_t px = cell / kY2, py = cell % kY2;
    std::array<Pieces, 4> pieces;
    std::size_t total = 0;
    for (std::size_t k = 0; k < 4; ++k) {
      const std::size_t x = 2 * px + k / 2, y = 2 * py + k % 2;
      for (std::size_t d = 0; d < 9; ++d) {
        if (scratch.active1[x + d / 3][y + d % 3]) pieces[k].add(d / 3, d % 3, kY1, kZ1, a_);
      }
      total += pieces[k].count;
    }
    if (total == 0) continue;
    scratch.active2[px + 1][py + 1] = true;
    for (std::size_t k = 0; k < 4; ++k) {
      const std::size_t x = 2 * px + k / 2, y = 2 * py + k % 2;
      for (std::size_t z = 0; z < kZ1; ++z) {
        input[z] = scratch.delta1.data() + (padded_column(x, y, kY1, kZ1) + z) * a_;
        start[z] = empty2_.data() + ((x * kY1 + y) * kZ1 + z) * b_;
        // The eight values that are pooled follow each other.
        output[z] = scratch.sums.data() + (z / 2 * 8 + k * 2 + z % 2) * b_;
      }
      kernels_.conv({kZ1, input.data(), start.data(), output.data(), pieces[k].count,
                     pieces[k].offset.data(), pieces[k].weight_row.data(), 3 * a_,
                     conv2_.weight.data(), conv2_.inputs, 0, b_, true});
    }
    for (std::size_t z = 0; z < kZ2; ++z) {
      float* out = scratch.delta2.data() + (padded_column(px + 1, py + 1, kY2, kZ2) + z + 1) * b_;
      const float* empty = pooled2_.data() + (cell * kZ2 + z) * b_;
      pool(scratch.sums.data() + z * 8 * b_, b_, b_, out);
      for (std::size_t c = 0; c < b_; ++c) out[c] -= empty[c];
    }
  }
}

// -> the third layer, (8, 8, 4, c). Sums start from `sums`, `stride` floats apart.
void VoxelNetwork::third(Scratch& scratch, const float* sums, std::size_t stride, float* features,
                         bool rectify) const {
  constexpr std::size_t kRows = 2 * kZ2;  // two columns at a time fill the registers
  std::array<const float*, kRows> input, start;
  std::array<float*, kRows> output;
  for (std::size_t x = 0; x < kX2; ++x) {
    for (std::size_t y = 0; y < kY2; y += 2) {
      Pieces pieces;
      for (std::size_t d = 0; d < 9; ++d) {
        const std::size_t nx = x + d / 3, ny = y + d % 3;
        if (scratch.active2[nx][ny] || scratch.active2[nx][ny + 1]) {
          pieces.add(d / 3, d % 3, kY2, kZ2, b_);
        }
      }
      for (std::size_t r = 0; r < kRows; ++r) {
        const std::size_t column = y + r / kZ2, z = r % kZ2;
        const std::size_t at = (x * kY2 + column) * kZ2 + z;
        input[r] = scratch.delta2.data() + (padded_column(x, column, kY2, kZ2) + z) * b_;
        start[r] = sums + at * stride;
        output[r] = features + at * c_;
      }
      kernels_.conv({kRows, input.data(), start.data(), output.data(), pieces.count,
                     pieces.offset.data(), pieces.weight_row.data(), 3 * b_, conv3_.weight.data(),
                     conv3_.inputs, 0, c_, rectify});
    }
  }
}

// max(input * weight + bias, 0) for some rows, panel by panel.
void VoxelNetwork::dense(const Layer& layer, const float* input, std::size_t stride,
                         std::size_t rows, int threads, float* output) const {
  const std::size_t panel = kernels_.panel;
  parallel_for(layer.outputs / panel, 1, threads, [&](std::size_t begin, std::size_t end, int) {
    std::array<const float*, kBatch> in, start;
    std::array<float*, kBatch> out;
    const std::size_t zero = 0;
    for (std::size_t first = 0; first < layer.inputs; first += kDenseRows) {
      const std::size_t length = std::min(kDenseRows, layer.inputs - first);
      for (std::size_t r = 0; r < rows; ++r) {
        in[r] = input + r * stride + first;
        out[r] = output + r * layer.outputs;
        start[r] = first == 0 ? layer.bias.data() : out[r];
      }
      kernels_.conv({rows, in.data(), start.data(), out.data(), 1, &zero, &first, length,
                     layer.weight.data(), layer.inputs, begin * panel, end * panel,
                     first + length == layer.inputs});
    }
  });
}

void VoxelNetwork::describe(const int32_t* voxels, const int64_t* offsets, const float* scales,
                            std::size_t segments, int threads, float* vectors) const {
  const std::size_t most = std::min(segments, kBatch);
  AlignedFloats features(most * features_), hidden(most * hidden_);
  for (std::size_t batch = 0; batch < segments; batch += kBatch) {
    const std::size_t rows = std::min(kBatch, segments - batch);
    parallel_for(rows, 4, threads, [&](std::size_t begin, std::size_t end, int) {
      Scratch scratch(*this);
      for (std::size_t r = begin; r < end; ++r) {
        const std::size_t s = batch + r;
        float* row = features.data() + r * features_;
        scratch.clear();
        first(voxels + offsets[s], static_cast<std::size_t>(offsets[s + 1] - offsets[s]), scratch);
        second(scratch);
        third(scratch, empty3_.data(), c_, row, true);
        std::copy_n(scales + 3 * s, 3, row + features_ - 3);
      }
    });
    dense(fc1_, features.data(), features_, rows, threads, hidden.data());
    dense(fc2_, hidden.data(), hidden_, rows, threads, vectors + batch * dim_);
  }
}

}  // namespace segloc
