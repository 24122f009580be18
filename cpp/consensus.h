// Pose from centroid matches when gravity is known: exhaustive consensus over pairs of matches.
#pragma once

#include <cstddef>
#include <cstdint>
#include <vector>

namespace segloc {

struct ConsensusOptions {
  double edge_tolerance = 0.5;    // two matches agree if their edges differ by less, metres
  double inlier_tolerance = 0.6;  // a match agrees with a pose if it lies closer, metres
  double height_tolerance = 1.0;  // the same two tests along z, metres
  double min_edge = 3.0;          // shorter edges say nothing about yaw, metres
  double distinct_radius = 1.0;   // query segments closer than this count as one object, metres
  double separation = 3.0;        // hypotheses closer than this (and than 15 degrees) are one
  std::size_t max_pivots = 128;   // candidates that are refined
  std::size_t max_hypotheses = 8;
};

struct PoseHypothesis {
  double yaw = 0.0;
  double t[3] = {0.0, 0.0, 0.0};  // T_map_query: p_map = Rz(yaw) p_query + t
  std::size_t inliers = 0;        // distinct objects that agree
  double score = 0.0;             // sum over them of 1 - (distance / tolerance)^2
};

// query: (q, 3) and map: (p, 3) centroids; match k pairs query[mq[k]] with map[mm[k]].
//
// Every match in turn is a pivot. The matches around it whose edge to the pivot has the same length
// in both frames vote for the yaw that turns one edge onto the other; distinct objects are counted
// in bins of yaw, so the best bin of a pivot is the best pose through it. The best pivots are
// refined on all their inliers. Nothing is drawn at random. Matches are sorted into cells as wide as
// the longest edge, so that far ones never meet: the cost grows with the density of matches in the
// map, not with their number squared. Returns distinct hypotheses, best score first.
std::vector<PoseHypothesis> pair_consensus(const double* query, std::size_t q, const double* map,
                                           const std::int64_t* mq, const std::int64_t* mm,
                                           std::size_t matches, const ConsensusOptions& options,
                                           int threads);

}  // namespace segloc
