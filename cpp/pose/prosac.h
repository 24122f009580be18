// PROSAC (Chum and Matas, CVPR 2005) on pairs of centroids; RANSAC is its unordered case.
#pragma once

#include <cstddef>
#include <cstdint>
#include <vector>

#include "common/rigid.h"

namespace segloc {

struct ProsacOptions {
  bool ordered = true;             // false: RANSAC, every sample from all matches
  bool yaw_only = false;           // yaw and translation from 2 matches; else SE(3) from 3
  double edge_tolerance = 0.5;     // edges of a sample must agree to this, metres
  double inlier_tolerance = 0.6;   // metres
  double min_edge = 3.0;           // shorter edges make a sample degenerate, metres
  double chance = 0.01;            // probability that a match fits a wrong pose (beta of the paper)
  double missed = 0.05;            // probability of having missed a better set (eta of the paper)
  double separation = 3.0;         // hypotheses closer than this are one, metres
  std::size_t max_draws = 200000;  // T_N of the paper, and the limit
  std::size_t max_hypotheses = 8;
  std::uint64_t seed = 0;
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
