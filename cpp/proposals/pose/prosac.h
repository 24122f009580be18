// PROSAC (Chum and Matas, CVPR 2005) on pairs of centroids; RANSAC is its unordered case.
#pragma once

#include <cstddef>
#include <cstdint>
#include <vector>

#include "common/rigid.h"

namespace segloc {

struct ProsacOptions {
  // Their values have one home: PoseConfig of the Python package.
  bool ordered;             // false: RANSAC, every sample from all matches
  double edge_tolerance;    // edges of a sample must agree to this, metres
  double inlier_tolerance;  // metres
  double min_edge;          // shorter edges make a sample degenerate, metres
  double chance;            // probability that a match fits a wrong pose (beta of the paper)
  double separation;        // hypotheses closer than this, and than the angle, are one, metres
  double separation_angle;  // radians
  std::size_t max_draws;    // T_N of the paper, and the limit
  std::size_t max_hypotheses;
  std::uint64_t seed;
  double missed = 0.05;  // probability of having missed a better set (eta of the paper)
};

struct SampledHypothesis {
  Rigid T;                  // target = T(source)
  std::size_t inliers = 0;  // one-to-one
};

// Pairs k = 0 .. n-1, best first: source[k] and target[k], (n, 3) row-major, which belong to the
// query segment query_id[k] and the map segment map_id[k] (a segment counts once in each pose).
// Returns distinct hypotheses, most inliers first. Deterministic by seed.
std::vector<SampledHypothesis> prosac(const double* source, const double* target,
                                      const std::int64_t* query_id, const std::int64_t* map_id,
                                      std::size_t n, const ProsacOptions& options);

}  // namespace segloc
