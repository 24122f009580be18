#include "proposals/matching/random_forest.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <stdexcept>

#include "common/parallel.h"

namespace segloc {
namespace {

constexpr std::size_t kBlock = 64;  // pairs whose features stay in cache while all trees see them
constexpr std::size_t kLanes = 8;   // pairs that descend a tree together: each hides others' waits

// Finite, and larger than any threshold.
float quotient(float a, float b) {
  return b > 0 ? std::min(a / b, std::numeric_limits<float>::max()) : 0.0f;
}

float intersection(const float* a, const float* b, std::size_t bins) {
  constexpr std::size_t kSums = 8;
  float sum[kSums] = {};
  std::size_t i = 0;
  for (; i + kSums <= bins; i += kSums) {
    for (std::size_t k = 0; k < kSums; ++k) sum[k] += std::min(a[i + k], b[i + k]);
  }
  for (; i < bins; ++i) sum[0] += std::min(a[i], b[i]);
  return ((sum[0] + sum[4]) + (sum[1] + sum[5])) + ((sum[2] + sum[6]) + (sum[3] + sum[7]));
}

void features_of_pair(const float* q, const float* m, std::size_t dim, const PairLayout& layout,
                      float* out) {
  const std::size_t P = layout.plain;
  for (std::size_t i = 0; i < P; ++i) out[i] = std::abs(q[i] - m[i]);
  if (layout.ratios) {
    for (std::size_t i = 0; i < P; ++i) {
      const float a = std::abs(q[i]), b = std::abs(m[i]);
      out[P + i] = quotient(out[i], b);
      out[2 * P + i] = quotient(out[i], a);
      out[3 * P + i] = a;
      out[4 * P + i] = b;
    }
  }
  out += (layout.ratios ? 5 : 1) * P;
  if (layout.histogram == 0) return;
  for (std::size_t start = P; start < dim; start += layout.histogram) {
    *out++ = intersection(q + start, m + start, layout.histogram);
  }
}

}  // namespace

std::size_t PairLayout::features(std::size_t dim) const {
  const std::size_t histograms = histogram > 0 ? (dim - plain) / histogram : 0;
  return (ratios ? 5 : 1) * plain + histograms;
}

void pair_features(const PairTask& task, const PairLayout& layout, int threads, float* output) {
  const std::size_t F = layout.features(task.dim);
  parallel_for(task.pairs, kBlock, threads, [&](std::size_t begin, std::size_t end, int) {
    for (std::size_t i = begin; i < end; ++i) {
      features_of_pair(task.query + static_cast<std::size_t>(task.rows[i]) * task.dim,
                       task.map + static_cast<std::size_t>(task.columns[i]) * task.dim, task.dim,
                       layout, output + i * F);
    }
  });
}

Forest::Forest(const ForestArrays& a, std::size_t features)
    : features_(features), roots_(a.roots, a.roots + a.trees) {
  if (a.trees == 0) throw std::invalid_argument("a forest needs at least one tree");
  const auto count = static_cast<int64_t>(a.nodes);
  for (const int32_t root : roots_) {
    if (root < 0 || root >= count) throw std::invalid_argument("a root is not among the nodes");
  }
  nodes_.reserve(a.nodes);
  for (std::size_t i = 0; i < a.nodes; ++i) {
    const int64_t child = a.first_child[i];
    // Children lie behind their parent, so every descent ends.
    if (child != -1 && (child <= static_cast<int64_t>(i) || child + 1 >= count)) {
      throw std::invalid_argument("a node's children must lie behind it");
    }
    if (a.feature[i] < 0 || static_cast<std::size_t>(a.feature[i]) >= features) {
      throw std::invalid_argument("a node names a feature that is not there");
    }
    if (!std::isfinite(a.threshold[i])) throw std::invalid_argument("a threshold is not finite");
    nodes_.push_back({a.threshold[i], a.first_child[i], a.feature[i]});
  }
}

void Forest::predict_block(const float* input, std::size_t rows, float* output) const {
  double sums[kBlock] = {};
  for (const int32_t root : roots_) {
    for (std::size_t first = 0; first < rows; first += kLanes) {
      const std::size_t lanes = std::min(kLanes, rows - first);
      const Node* at[kLanes];
      for (std::size_t k = 0; k < lanes; ++k) at[k] = &nodes_[static_cast<std::size_t>(root)];
      for (bool moving = true; moving;) {
        moving = false;
        for (std::size_t k = 0; k < lanes; ++k) {
          const Node& node = *at[k];
          if (node.first_child < 0) continue;
          const float value =
              input[(first + k) * features_ + static_cast<std::size_t>(node.feature)];
          at[k] = &nodes_[static_cast<std::size_t>(node.first_child + (value > node.threshold))];
          moving = true;
        }
      }
      for (std::size_t k = 0; k < lanes; ++k) sums[first + k] += at[k]->threshold;
    }
  }
  for (std::size_t i = 0; i < rows; ++i) {
    output[i] = static_cast<float>(sums[i] / static_cast<double>(roots_.size()));
  }
}

void Forest::predict(const float* input, std::size_t rows, int threads, float* output) const {
  parallel_for(rows, kBlock, threads, [&](std::size_t begin, std::size_t end, int) {
    predict_block(input + begin * features_, end - begin, output + begin);
  });
}

void Forest::predict_pairs(const PairTask& task, const PairLayout& layout, int threads,
                           float* output) const {
  parallel_for(task.pairs, kBlock, threads, [&](std::size_t begin, std::size_t end, int) {
    std::vector<float> features((end - begin) * features_);
    PairTask part = task;
    part.rows += begin;
    part.columns += begin;
    part.pairs = end - begin;
    pair_features(part, layout, 1, features.data());
    predict_block(features.data(), part.pairs, output + begin);
  });
}

}  // namespace segloc
