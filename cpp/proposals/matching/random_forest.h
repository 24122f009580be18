// Random forests over pairs of descriptors, which prune candidate matches.
#pragma once

#include <cstddef>
#include <cstdint>
#include <vector>

namespace segloc {

// Trees one after another. The children of node i are first_child[i] (feature <= threshold) and the
// node behind it; a leaf has none (-1) and its threshold is the tree's answer.
struct ForestArrays {
  const int32_t* roots;
  std::size_t trees;
  const int32_t* feature;
  const float* threshold;
  const int32_t* first_child;
  std::size_t nodes;
};

// Features of a pair of descriptors.
struct PairLayout {
  std::size_t plain;      // the first values are compared one by one,
  bool ratios;            // with their relative differences and the values themselves or without
  std::size_t histogram;  // bins of each of the histograms that follow; 0: none
  std::size_t features(std::size_t dim) const;
};

struct PairTask {
  const float* query;  // (queries, dim)
  const float* map;    // (segments, dim)
  std::size_t dim;
  const int64_t* rows;     // of query, one a pair
  const int64_t* columns;  // of map
  std::size_t pairs;
};

// output (pairs, features): |d| of the plain values; if ratios, |d| / |map|, |d| / |query|,
// |query| and |map| (quotients by zero are zero); then the intersection, the sum of the smaller
// values, of each histogram.
void pair_features(const PairTask& task, const PairLayout& layout, int threads, float* output);

class Forest {
 public:
  // Checks that the trees end, and that their features are below `features`; throws
  // std::invalid_argument.
  Forest(const ForestArrays& arrays, std::size_t features);

  std::size_t features() const { return features_; }

  // The mean answer of the trees for each row of input (rows, features()).
  void predict(const float* input, std::size_t rows, int threads, float* output) const;

  // The same for pairs of descriptors, without keeping their features.
  void predict_pairs(const PairTask& task, const PairLayout& layout, int threads,
                     float* output) const;

 private:
  struct Node {
    float threshold;
    int32_t first_child;
    int32_t feature;
  };
  void predict_block(const float* input, std::size_t rows, float* output) const;

  std::size_t features_;
  std::vector<int32_t> roots_;
  std::vector<Node> nodes_;
};

}  // namespace segloc
