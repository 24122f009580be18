#include "proposals/pose/pose_refinement.h"

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <vector>

namespace segloc {
namespace {

constexpr std::size_t kBlock = 256;

struct Inlier {
  std::size_t match;
  double squared;  // horizontal distance
};

// One match for each object of the query and each segment of the map, nearest first.
std::vector<Inlier> distinct_inliers(const MatchTable& f, const PoseHypothesis& pose,
                                     double tolerance, double height, const Kernels& kernels) {
  const double c = std::cos(pose.yaw), s = std::sin(pose.yaw);
  // Single precision finds all that double precision may accept; that then decides.
  const double farthest = f.farthest + std::fabs(pose.t[0]) + std::fabs(pose.t[1]);
  const double max_distance = tolerance + 1e-6 * (farthest + tolerance);
  const PoseTest test{static_cast<float>(c), static_cast<float>(s), static_cast<float>(pose.t[0]),
                      static_cast<float>(pose.t[1]),
                      static_cast<float>(max_distance * max_distance)};
  const MatchArrays arrays = f.arrays();
  std::uint32_t close[kBlock];
  std::vector<Inlier> near;
  for (const MatchRange& range : ranges_near(f, test, max_distance)) {
    for (std::size_t begin = range.begin; begin < range.end; begin += kBlock) {
      const std::size_t end = std::min(begin + kBlock, range.end);
      const std::size_t count = kernels.near_pose(arrays, test, begin, end, close);
      for (std::size_t i = 0; i < count; ++i) {
        const std::size_t k = close[i];
        const double dx = c * f.qx[k] - s * f.qy[k] + pose.t[0] - f.mx[k];
        const double dy = s * f.qx[k] + c * f.qy[k] + pose.t[1] - f.my[k];
        const double d2 = dx * dx + dy * dy;
        if (d2 > tolerance * tolerance) continue;
        if (std::fabs(f.qz[k] + pose.t[2] - f.mz[k]) <= height) near.push_back({k, d2});
      }
    }
  }
  std::sort(near.begin(), near.end(), [](const Inlier& a, const Inlier& b) {
    return a.squared != b.squared ? a.squared < b.squared : a.match < b.match;
  });
  std::vector<Inlier> kept;
  std::vector<bool> groups(f.groups), segments(f.map_segments);
  for (const Inlier& candidate : near) {
    const std::uint32_t group = f.group[candidate.match];
    const std::uint32_t segment = f.map_segment[candidate.match];
    if (groups[group] || segments[segment]) continue;
    groups[group] = segments[segment] = true;
    kept.push_back(candidate);
  }
  return kept;
}

void fit(const MatchTable& f, const std::vector<Inlier>& inliers, PoseHypothesis& pose) {
  const double n = static_cast<double>(inliers.size());
  double q[3] = {0, 0, 0}, m[3] = {0, 0, 0}, dot = 0.0, cross = 0.0;
  for (const Inlier& in : inliers) {
    const std::size_t k = in.match;
    q[0] += f.qx[k] / n, q[1] += f.qy[k] / n, q[2] += f.qz[k] / n;
    m[0] += f.mx[k] / n, m[1] += f.my[k] / n, m[2] += f.mz[k] / n;
  }
  for (const Inlier& in : inliers) {
    const std::size_t k = in.match;
    const double ax = f.qx[k] - q[0], ay = f.qy[k] - q[1], bx = f.mx[k] - m[0], by = f.my[k] - m[1];
    dot += ax * bx + ay * by;
    cross += ax * by - ay * bx;
  }
  if (inliers.size() > 1) pose.yaw = std::atan2(cross, dot);
  const double c = std::cos(pose.yaw), s = std::sin(pose.yaw);
  pose.t[0] = m[0] - (c * q[0] - s * q[1]);
  pose.t[1] = m[1] - (s * q[0] + c * q[1]);
  pose.t[2] = m[2] - q[2];
}

}  // namespace

PoseHypothesis refine(const MatchTable& f, const PoseStart& start, const ConsensusOptions& o,
                      const Kernels& kernels) {
  PoseHypothesis pose = start.pose;
  // Far inliers are off by the error of the first yaw: the tolerance starts wide.
  for (const double factor : {2.0, 1.5, 1.0, 1.0}) {
    const auto inliers =
        distinct_inliers(f, pose, factor * o.inlier_tolerance, o.height_tolerance, kernels);
    if (inliers.size() < 2) break;
    fit(f, inliers, pose);
  }
  for (const Inlier& in :
       distinct_inliers(f, pose, o.inlier_tolerance, o.height_tolerance, kernels)) {
    ++pose.inliers;
    pose.score += 1.0 - in.squared / (o.inlier_tolerance * o.inlier_tolerance);
  }
  return pose;
}

}  // namespace segloc
