// Pose from centroid matches when gravity is known: consensus of votes.
#pragma once

#include <cstddef>
#include <cstdint>
#include <vector>

namespace segloc {

struct ConsensusOptions {
  // Their values have one home: PoseConfig of the Python package.
  double inlier_tolerance;  // a match agrees with a pose if it lies closer, metres
  double height_tolerance;  // the same along z, metres
  double distinct_radius;   // query segments closer than this count as one object, metres
  double separation;        // hypotheses closer than this, and than the angle, are one, metres
  double separation_angle;  // radians
  std::size_t max_refined;  // candidates that are refined
  std::size_t max_hypotheses;
  std::size_t max_votes = 32768;  // matches that vote; the first ones
  std::size_t max_cells = 512;    // cells of poses that are searched
};

struct PoseHypothesis {
  double yaw = 0.0;
  double t[3] = {0.0, 0.0, 0.0};  // T_map_query: p_map = Rz(yaw) p_query + t
  std::size_t inliers = 0;        // distinct objects that agree
  double score = 0.0;             // sum over them of 1 - (distance / tolerance)^2
};

// query: (q, 3) and map: (p, 3) centroids; match k pairs query[mq[k]] with map[mm[k]].
//
// The first max_votes matches vote for cells of yaw and translation (pose_votes.h, and
// docs/explanation/votes.md). The cells with the most votes are divided and voted for again, and
// the best parts of them are refined on all their inliers, at each height that several objects
// agree on: storeys of a building are different places. Nothing is drawn at random, and the cost
// grows with the number of matches, not with its square. Returns distinct hypotheses, best score
// first.
std::vector<PoseHypothesis> consensus(const double* query, std::size_t q, const double* map,
                                      const std::int64_t* mq, const std::int64_t* mm,
                                      std::size_t matches, const ConsensusOptions& options,
                                      int threads);

}  // namespace segloc
