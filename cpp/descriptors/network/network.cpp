#include "descriptors/network/network.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <stdexcept>

#include "common/parallel.h"
#include "descriptors/network/neighbors.h"
#include "descriptors/network/network_pack.h"

namespace segloc {
namespace {

// Segments that pass through the network together. Enough to fill the vectors of the last layers
// and to use each weight several times from cache; few enough that their features stay in cache.
constexpr std::size_t kBatch = 8;

void check(const std::vector<LayerSpec>& layers, std::size_t points) {
  if (layers.empty()) throw std::invalid_argument("a network needs at least one layer");
  if (points == 0 || points > 65535) {
    throw std::invalid_argument("a network reads 1 to 65535 points");
  }
  std::size_t sources = points;
  for (const LayerSpec& l : layers) {
    const bool positive = l.points > 0 && l.neighbors > 0 && l.dilation > 0 && l.channels > 0;
    if (!positive || l.neighbors > 64 || l.channels > 65536 ||
        static_cast<std::size_t>(l.points) > sources ||
        static_cast<std::size_t>(l.neighbors) * static_cast<std::size_t>(l.dilation) > sources) {
      throw std::invalid_argument(
          "layer table: each layer needs N and K * D within the points of the one before, "
          "and K of at most 64");
    }
    sources = static_cast<std::size_t>(l.points);
  }
}

std::size_t channel_stride(const LayerSpec& spec) {
  return padded(static_cast<std::size_t>(spec.channels), kChannelPad);
}

}  // namespace

// All memory that one worker needs, allocated once a call.
struct Network::Scratch {
  explicit Scratch(const Network& network) {
    std::size_t coordinates = padded(network.points_, 16), features = 0, indices = 0;
    std::size_t relative = 0, transform = 0, lifted = 0, separated = 0, rows = 0;
    const std::size_t block = network.kernels_.block;
    for (std::size_t l = 0; l < network.specs_.size(); ++l) {
      const LayerSpec& spec = network.specs_[l];
      const XConvWeights& w = network.xconv_[l];
      const auto N = static_cast<std::size_t>(spec.points);
      const auto K = static_cast<std::size_t>(spec.neighbors);
      features = std::max(features, N * channel_stride(spec));
      indices = std::max(indices, N * K);
      relative = std::max(relative, 3 * K * block);
      transform = std::max(transform, K * K * block);
      lifted = std::max(lifted, K * w.lifted_pad);
      separated = std::max(separated, block * (w.pointwise.inputs + kChannelPad));
      rows = std::max(rows, block * K);
    }
    position_stride = coordinates;
    positions = AlignedFloats(kBatch * 3 * coordinates);
    search = AlignedFloats(neighbor_scratch_size(network.points_));
    neighbors.resize(kBatch * indices);
    previous = AlignedFloats(kBatch * features);
    current = AlignedFloats(kBatch * features);
    relatives = AlignedFloats(relative);
    x_a = AlignedFloats(transform);
    x_b = AlignedFloats(transform);
    lift_hidden = AlignedFloats(lifted);
    lift_out = AlignedFloats(lifted);
    separations = AlignedFloats(separated);
    feature_rows.resize(rows);

    const auto last = static_cast<std::size_t>(network.specs_.back().points);
    const std::size_t g = padded(network.global_channels_, kChannelPad);
    global_a = AlignedFloats(last * g);
    global_b = AlignedFloats(last * g);
    const auto C = static_cast<std::size_t>(network.specs_.back().channels);
    pooled_stride = C + network.global_channels_;
    pooled = AlignedFloats(kBatch * pooled_stride);
    fc1 = AlignedFloats(kBatch * padded(network.hidden1_, kChannelPad));
    fc2 = AlignedFloats(kBatch * padded(network.hidden2_, kChannelPad));
    fc3 = AlignedFloats(kBatch * padded(network.dim_, kChannelPad));
    quality = AlignedFloats(kBatch * kChannelPad);
  }

  // x, y and z of each segment, padded with infinity.
  void load(const float* prepared, std::size_t segments, std::size_t points) {
    for (std::size_t s = 0; s < segments; ++s) {
      const float* p = prepared + s * points * 3;
      for (std::size_t d = 0; d < 3; ++d) {
        float* out = coordinate(s, d);
        for (std::size_t i = 0; i < points; ++i) out[i] = p[3 * i + d];
      }
    }
  }
  float* coordinate(std::size_t segment, std::size_t axis) {
    return positions.data() + (segment * 3 + axis) * position_stride;
  }

  std::size_t position_stride, pooled_stride;
  AlignedFloats positions, search, previous, current, relatives, x_a, x_b, lift_hidden, lift_out,
      separations, global_a, global_b, pooled, fc1, fc2, fc3, quality;
  std::vector<uint16_t> neighbors;
  std::vector<const float*> feature_rows;
};

Network::Network(const std::vector<LayerSpec>& layers, std::size_t points, const Tensors& tensors,
                 Isa isa)
    : kernels_(segloc::kernels(isa)), specs_(layers), points_(points) {
  check(layers, points);
  WeightPacker packer(tensors, kernels_);
  std::size_t channels = 0;
  for (std::size_t l = 0; l < layers.size(); ++l) {
    xconv_.push_back(packer.xconv("layers." + std::to_string(l), layers[l], channels));
    channels = static_cast<std::size_t>(layers[l].channels);
  }
  global_channels_ = packer.extent("global1.weight", 1);
  global1_ = packer.dense("global1", 3, global_channels_, true, false, false);
  global2_ = packer.dense("global2", global_channels_, global_channels_, true, true, true);
  hidden1_ = packer.extent("fc1.weight", 1);
  hidden2_ = packer.extent("fc2.weight", 1);
  dim_ = packer.extent("fc3.weight", 1);
  fc1_ = packer.dense("fc1", channels + global_channels_, hidden1_, true, true, false);
  fc2_ = packer.dense("fc2", hidden1_, hidden2_, true, true, false);
  fc3_ = packer.dense("fc3", hidden2_, dim_, false, true, false);
  quality_ = packer.dense("quality", dim_, 1, false, true, false);
  memory_ = packer.finish();
}

std::size_t Network::sources(std::size_t layer) const {
  return layer == 0 ? points_ : static_cast<std::size_t>(specs_[layer - 1].points);
}

void Network::find_neighbors(std::size_t layer, std::size_t segments, Scratch& scratch) const {
  const LayerSpec& spec = specs_[layer];
  const std::size_t count = sources(layer), stride = padded(count, 16);
  const auto queries = static_cast<std::size_t>(spec.points);
  const auto K = static_cast<std::size_t>(spec.neighbors);
  for (std::size_t s = 0; s < segments; ++s) {
    // The sources are a prefix, so only what follows it in the last vector must not be near.
    float* xyz[3];
    for (std::size_t d = 0; d < 3; ++d) {
      xyz[d] = scratch.coordinate(s, d);
      std::fill(xyz[d] + count, xyz[d] + stride, std::numeric_limits<float>::infinity());
    }
    kernels_.neighbors({xyz[0], xyz[1], xyz[2], count, queries, spec.neighbors, spec.dilation,
                        scratch.search.data(), scratch.neighbors.data() + s * queries * K});
  }
}

void Network::run_layer(std::size_t layer, std::size_t segments, Scratch& scratch) const {
  find_neighbors(layer, segments, scratch);
  const LayerSpec& spec = specs_[layer];
  const XConvWeights& weights = xconv_[layer];
  const auto queries = static_cast<std::size_t>(spec.points);
  const auto K = static_cast<std::size_t>(spec.neighbors);
  const std::size_t block = kernels_.block, total = segments * queries;
  const std::size_t in_stride = weights.inputs_pad, in_points = sources(layer);

  XConvTask task;
  task.relative = scratch.relatives.data();
  task.features = scratch.feature_rows.data();
  task.x_a = scratch.x_a.data();
  task.x_b = scratch.x_b.data();
  task.lift_hidden = scratch.lift_hidden.data();
  task.lifted = scratch.lift_out.data();
  task.separated = scratch.separations.data();
  task.separated_stride = weights.pointwise.inputs + kChannelPad;
  task.output_stride = channel_stride(spec);
  for (std::size_t first = 0; first < total; first += block) {
    task.count = std::min(block, total - first);
    for (std::size_t i = 0; i < task.count; ++i) {
      const std::size_t s = (first + i) / queries, q = (first + i) % queries;
      const float* x = scratch.coordinate(s, 0);
      const float* y = scratch.coordinate(s, 1);
      const float* z = scratch.coordinate(s, 2);
      const uint16_t* near = scratch.neighbors.data() + (s * queries + q) * K;
      float* relative = scratch.relatives.data() + i;
      for (std::size_t k = 0; k < K; ++k) {
        const std::size_t j = near[k];
        relative[(3 * k) * block] = x[j] - x[q];
        relative[(3 * k + 1) * block] = y[j] - y[q];
        relative[(3 * k + 2) * block] = z[j] - z[q];
        scratch.feature_rows[i * K + k] = scratch.previous.data() + (s * in_points + j) * in_stride;
      }
    }
    task.output = scratch.current.data() + first * task.output_stride;
    kernels_.xconv(weights, task);
  }
  std::swap(scratch.previous, scratch.current);
}

void Network::head(const float* prepared, std::size_t segments, Scratch& scratch, float* vectors,
                   float* quality) const {
  const LayerSpec& spec = specs_.back();
  const auto N = static_cast<std::size_t>(spec.points);
  const auto C = static_cast<std::size_t>(spec.channels);
  const std::size_t stride = channel_stride(spec), g = padded(global_channels_, kChannelPad);
  const float share = 1.0f / static_cast<float>(N);
  for (std::size_t s = 0; s < segments; ++s) {
    kernels_.dense(global1_, prepared + s * points_ * 3, 3, N, scratch.global_a.data(), g);
    kernels_.dense(global2_, scratch.global_a.data(), g, N, scratch.global_b.data(), g);
    float* pooled = scratch.pooled.data() + s * scratch.pooled_stride;
    std::fill(pooled, pooled + scratch.pooled_stride, 0.0f);
    for (std::size_t i = 0; i < N; ++i) {
      const float* feature = scratch.previous.data() + (s * N + i) * stride;
      for (std::size_t c = 0; c < C; ++c) pooled[c] += feature[c];
      const float* global = scratch.global_b.data() + i * g;
      for (std::size_t c = 0; c < global_channels_; ++c) pooled[C + c] += global[c];
    }
    for (std::size_t c = 0; c < scratch.pooled_stride; ++c) pooled[c] *= share;
  }
  const std::size_t h1 = padded(hidden1_, kChannelPad), h2 = padded(hidden2_, kChannelPad);
  const std::size_t out = padded(dim_, kChannelPad);
  kernels_.dense(fc1_, scratch.pooled.data(), scratch.pooled_stride, segments, scratch.fc1.data(),
                 h1);
  kernels_.dense(fc2_, scratch.fc1.data(), h1, segments, scratch.fc2.data(), h2);
  kernels_.dense(fc3_, scratch.fc2.data(), h2, segments, scratch.fc3.data(), out);
  kernels_.dense(quality_, scratch.fc3.data(), out, segments, scratch.quality.data(), kChannelPad);
  for (std::size_t s = 0; s < segments; ++s) {
    std::copy_n(scratch.fc3.data() + s * out, dim_, vectors + s * dim_);
    quality[s] = 1.0f / (1.0f + std::exp(-scratch.quality[s * kChannelPad]));
  }
}

void Network::describe(const float* prepared, std::size_t segments, int threads, float* vectors,
                       float* quality) const {
  const std::size_t batches = (segments + kBatch - 1) / kBatch;
  const int workers = static_cast<int>(
      std::min<std::size_t>(static_cast<std::size_t>(resolve_threads(threads)), batches));
  std::vector<Scratch> scratch;
  scratch.reserve(static_cast<std::size_t>(workers));
  for (int i = 0; i < workers; ++i) scratch.emplace_back(*this);
  parallel_for(batches, 1, workers, [&](std::size_t begin, std::size_t end, int worker) {
    Scratch& own = scratch[static_cast<std::size_t>(worker)];
    for (std::size_t b = begin; b < end; ++b) {
      const std::size_t first = b * kBatch, count = std::min(kBatch, segments - first);
      const float* input = prepared + first * points_ * 3;
      own.load(input, count, points_);
      for (std::size_t l = 0; l < specs_.size(); ++l) run_layer(l, count, own);
      head(input, count, own, vectors + first * dim_, quality + first);
    }
  });
}

void Network::activations(const float* prepared, std::size_t segments, std::size_t layer,
                          float* output) const {
  Scratch scratch(*this);
  const LayerSpec& spec = specs_[layer];
  const auto N = static_cast<std::size_t>(spec.points);
  const auto C = static_cast<std::size_t>(spec.channels);
  const std::size_t stride = channel_stride(spec);
  for (std::size_t first = 0; first < segments; first += kBatch) {
    const std::size_t count = std::min(kBatch, segments - first);
    scratch.load(prepared + first * points_ * 3, count, points_);
    for (std::size_t l = 0; l <= layer; ++l) run_layer(l, count, scratch);
    for (std::size_t i = 0; i < count * N; ++i) {
      std::copy_n(scratch.previous.data() + i * stride, C, output + (first * N + i) * C);
    }
  }
}

}  // namespace segloc
