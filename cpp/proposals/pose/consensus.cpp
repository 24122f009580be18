#include "proposals/pose/consensus.h"

#include <algorithm>
#include <cmath>

#include "common/angles.h"
#include "common/parallel.h"
#include "proposals/pose/match_table.h"
#include "proposals/pose/pose_refinement.h"
#include "proposals/pose/pose_start.h"
#include "proposals/pose/pose_votes.h"
#include "simd/kernels.h"

namespace segloc {
namespace {

constexpr double kSameStart = 0.75 * kPi / 180.0;

double wrap(double angle) { return angle - 2.0 * kPi * std::floor(angle / (2.0 * kPi) + 0.5); }

// Poses that differ by more in height have no match in common: they are on other storeys.
bool same_level(const PoseHypothesis& a, const PoseHypothesis& b, const ConsensusOptions& o) {
  return std::fabs(a.t[2] - b.t[2]) <= 2.0 * o.height_tolerance;
}

bool explains(const PoseHypothesis& pose, const MatchTable& f, const PoseStart& start,
              const ConsensusOptions& o) {
  const std::size_t k = start.index;
  const double c = std::cos(pose.yaw), s = std::sin(pose.yaw);
  const double dx = c * f.qx[k] - s * f.qy[k] + pose.t[0] - f.mx[k];
  const double dy = s * f.qx[k] + c * f.qy[k] + pose.t[1] - f.my[k];
  return dx * dx + dy * dy <= o.inlier_tolerance * o.inlier_tolerance &&
         same_level(pose, start.pose, o) && std::fabs(wrap(pose.yaw - start.pose.yaw)) < kSameStart;
}

bool same_place(const PoseHypothesis& a, const PoseHypothesis& b, const ConsensusOptions& o) {
  return same_level(a, b, o) && std::hypot(a.t[0] - b.t[0], a.t[1] - b.t[1]) < o.separation &&
         std::fabs(wrap(a.yaw - b.yaw)) < o.separation_angle;
}

}  // namespace

std::vector<PoseHypothesis> consensus(const double* query, std::size_t q, const double* map,
                                      const std::int64_t* mq, const std::int64_t* mm,
                                      std::size_t matches, const ConsensusOptions& o, int threads) {
  if (matches < 2) return {};
  // Map coordinates may be as large as UTM's: floats are taken relative to one of the matches.
  const double* origin = map + 3 * mm[0];
  const MatchTable f =
      make_match_table({query, q, map, mq, mm, matches}, origin, o.distinct_radius);

  const Kernels& kernel_table = kernels(parse_isa("auto"));
  const PoseVotes votes =
      vote_for_poses(f, {o.inlier_tolerance, o.max_votes, o.max_cells, 0.4, 64}, threads);
  std::vector<std::vector<PoseStart>> found(votes.cells.size());
  parallel_for(found.size(), 4, threads, [&](std::size_t begin, std::size_t end, int) {
    for (std::size_t i = begin; i < end; ++i) {
      found[i] = best_starts(f, votes.cells[i], votes, o, kernel_table);
    }
  });
  std::vector<PoseStart> starts;
  for (const auto& each : found) starts.insert(starts.end(), each.begin(), each.end());
  std::stable_sort(starts.begin(), starts.end(),
                   [](const PoseStart& a, const PoseStart& b) { return a.support > b.support; });

  std::vector<PoseHypothesis> refined;
  for (const PoseStart& start : starts) {
    if (refined.size() >= o.max_refined || start.support == 0) break;
    const bool known = std::any_of(refined.begin(), refined.end(), [&](const PoseHypothesis& pose) {
      return explains(pose, f, start, o);
    });
    if (!known) refined.push_back(refine(f, start, o, kernel_table));
  }
  std::stable_sort(refined.begin(), refined.end(),
                   [](const auto& a, const auto& b) { return a.score > b.score; });
  std::vector<PoseHypothesis> distinct;
  for (const PoseHypothesis& pose : refined) {
    if (distinct.size() >= o.max_hypotheses) break;
    const bool known = std::any_of(distinct.begin(), distinct.end(),
                                   [&](const auto& other) { return same_place(pose, other, o); });
    if (!known) distinct.push_back(pose);
  }
  for (PoseHypothesis& pose : distinct) {
    for (int a = 0; a < 3; ++a) pose.t[a] += origin[a];
  }
  return distinct;
}

}  // namespace segloc
