#include "consensus.h"

#include <algorithm>
#include <array>
#include <cmath>

#include "kernels.h"
#include "match_field.h"
#include "parallel.h"
#include "pose_votes.h"

namespace segloc {
namespace {

constexpr double kPi = 3.14159265358979323846;
constexpr int kFineSteps = 6;    // that a step of yaw is divided into
constexpr double kTypical = 0.7;  // share of the tolerance that most matches keep
constexpr double kSameYaw = 15.0 * kPi / 180.0;
constexpr double kSameStart = 0.75 * kPi / 180.0;
constexpr std::size_t kBlock = 256;
constexpr double kShare = 0.4;  // of the most votes: emptier cells are not looked into

double longest_edge(const double* query, std::size_t q) {
  double low[2] = {1e300, 1e300}, high[2] = {-1e300, -1e300};
  for (std::size_t i = 0; i < q; ++i) {
    for (int a = 0; a < 2; ++a) {
      low[a] = std::min(low[a], query[3 * i + a]);
      high[a] = std::max(high[a], query[3 * i + a]);
    }
  }
  return std::hypot(high[0] - low[0], high[1] - low[1]);
}

double wrap(double angle) { return angle - 2.0 * kPi * std::floor(angle / (2.0 * kPi) + 0.5); }

// Where refinement starts.
struct Start {
  std::size_t index = 0;  // of a match that agrees
  std::size_t support = 0;
  PoseHypothesis pose;
};

// The matches that a cell of poses gathers, one object after another.
std::vector<std::uint32_t> gather(const Field& f, const PoseCell& cell, double width,
                                  const Kernels& kernels) {
  MatchRange ranges[3];
  ranges_around(f, f.keys[cell.index], ranges);
  const PoseTest test{static_cast<float>(std::cos(cell.yaw)),
                      static_cast<float>(std::sin(cell.yaw)), static_cast<float>(cell.x),
                      static_cast<float>(cell.y), static_cast<float>(1.5 * width * width)};
  std::vector<std::uint32_t> gathered;
  std::uint32_t close[kBlock];
  for (const MatchRange& range : ranges) {
    for (std::size_t begin = range.begin; begin < range.end; begin += kBlock) {
      const std::size_t end = std::min(begin + kBlock, range.end);
      const std::size_t count = kernels.near_pose(f.columns(), test, begin, end, close);
      gathered.insert(gathered.end(), close, close + count);
    }
  }
  std::stable_sort(gathered.begin(), gathered.end(), [&](std::uint32_t a, std::uint32_t b) {
    return f.group[a] < f.group[b];
  });
  return gathered;
}

// Votes on a few square metres of translations at one yaw. Voters come one object after another.
class FineVotes {
 public:
  FineVotes(double x, double y, double reach, double width)
      : x_(x - reach), y_(y - reach), width_(width),
        side_(static_cast<int>(2.0 * reach / width) + 2),
        counters_(static_cast<std::size_t>(side_ * side_)) {}

  void clear() { std::fill(counters_.begin(), counters_.end(), Counter{}); }

  void add(double x, double y, std::uint32_t group, std::uint32_t match) {
    const int column = cell(x - x_), row = cell(y - y_);
    for (int corner = 0; corner < 4; ++corner) {
      const int i = column + (corner & 1), j = row + (corner >> 1);
      if (i < 0 || j < 0 || i >= side_ || j >= side_) continue;
      Counter& counter = counters_[static_cast<std::size_t>(j * side_ + i)];
      if (counter.votes != 0 && counter.group == group) continue;
      counter = {counter.votes + 1, group, match};
    }
  }

  // Whether some cell has more votes than the start; which then is moved there.
  bool improve(Start& start) const {
    std::size_t best = start.support, at = counters_.size();
    for (std::size_t k = 0; k < counters_.size(); ++k) {
      if (counters_[k].votes <= best) continue;
      best = counters_[k].votes;
      at = k;
    }
    if (at == counters_.size()) return false;
    start.support = best;
    start.index = counters_[at].match;
    start.pose.t[0] = x_ + width_ * static_cast<double>(at % static_cast<std::size_t>(side_));
    start.pose.t[1] = y_ + width_ * static_cast<double>(at / static_cast<std::size_t>(side_));
    return true;
  }

 private:
  struct Counter {
    std::uint32_t votes = 0, group = 0, match = 0;  // the last voter
  };

  int cell(double offset) const { return static_cast<int>(std::floor(offset / width_)); }

  double x_, y_, width_;
  int side_;
  std::vector<Counter> counters_;
};

double median_height(const Field& f, const std::vector<std::uint32_t>& matches,
                     const PoseHypothesis& pose, double reach) {
  const double c = std::cos(pose.yaw), s = std::sin(pose.yaw);
  std::vector<float> heights;
  for (const std::uint32_t k : matches) {
    const double dx = c * f.qx[k] - s * f.qy[k] + pose.t[0] - f.mx[k];
    const double dy = s * f.qx[k] + c * f.qy[k] + pose.t[1] - f.my[k];
    if (dx * dx + dy * dy <= reach * reach) heights.push_back(f.mz[k] - f.qz[k]);
  }
  if (heights.empty()) return 0.0;
  const auto middle = heights.begin() + static_cast<std::ptrdiff_t>(heights.size() / 2);
  std::nth_element(heights.begin(), middle, heights.end());
  return *middle;
}

// The pose of a cell that most matches agree on: the cell is divided and voted for again.
Start best_start(const Field& f, const PoseCell& cell, const PoseVotes& votes,
                 const ConsensusOptions& o, const Kernels& kernels) {
  const std::vector<std::uint32_t> matches = gather(f, cell, votes.width, kernels);
  const double turn = votes.turn / kFineSteps;
  const double width = 2.0 * (kTypical * o.inlier_tolerance + 0.5 * turn * votes.radius);
  // The query turns about its middle, as it did in the coarse vote.
  const double c0 = std::cos(cell.yaw), s0 = std::sin(cell.yaw);
  const double middle[2] = {c0 * votes.middle[0] - s0 * votes.middle[1] + cell.x,
                            s0 * votes.middle[0] + c0 * votes.middle[1] + cell.y};
  FineVotes fine(middle[0], middle[1], votes.width, width);
  Start start;
  for (int step = 0; step <= kFineSteps; ++step) {
    const double yaw = cell.yaw + (step - 0.5 * kFineSteps) * turn;
    const double c = std::cos(yaw), s = std::sin(yaw);
    fine.clear();
    for (const std::uint32_t k : matches) {
      const double x = f.qx[k] - votes.middle[0], y = f.qy[k] - votes.middle[1];
      fine.add(f.mx[k] - (c * x - s * y), f.my[k] - (s * x + c * y), f.group[k], k);
    }
    if (fine.improve(start)) start.pose.yaw = yaw;
  }
  const double c = std::cos(start.pose.yaw), s = std::sin(start.pose.yaw);
  start.pose.t[0] -= c * votes.middle[0] - s * votes.middle[1];
  start.pose.t[1] -= s * votes.middle[0] + c * votes.middle[1];
  start.pose.t[2] = median_height(f, matches, start.pose, width);
  return start;
}

struct Inlier {
  std::size_t match;
  double squared;  // horizontal distance
};

// One match for each object of the query and each segment of the map, nearest first.
std::vector<Inlier> distinct_inliers(const Field& f, const MatchRange ranges[3],
                                     const PoseHypothesis& pose, double tolerance, double height,
                                     const Kernels& kernels) {
  const double c = std::cos(pose.yaw), s = std::sin(pose.yaw);
  // Single precision finds all that double precision may accept; that then decides.
  const double farthest = f.farthest + std::fabs(pose.t[0]) + std::fabs(pose.t[1]);
  const double reach = tolerance + 1e-6 * (farthest + tolerance);
  const PoseTest test{static_cast<float>(c),         static_cast<float>(s),
                      static_cast<float>(pose.t[0]), static_cast<float>(pose.t[1]),
                      static_cast<float>(reach * reach)};
  const MatchField columns = f.columns();
  std::uint32_t close[kBlock];
  std::vector<Inlier> near;
  for (int r = 0; r < 3; ++r) {
    for (std::size_t begin = ranges[r].begin; begin < ranges[r].end; begin += kBlock) {
      const std::size_t end = std::min(begin + kBlock, ranges[r].end);
      const std::size_t count = kernels.near_pose(columns, test, begin, end, close);
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
  std::vector<bool> groups(f.groups), sites(f.sites);
  for (const Inlier& candidate : near) {
    const std::uint32_t group = f.group[candidate.match], site = f.site[candidate.match];
    if (groups[group] || sites[site]) continue;
    groups[group] = sites[site] = true;
    kept.push_back(candidate);
  }
  return kept;
}

void fit(const Field& f, const std::vector<Inlier>& inliers, PoseHypothesis& pose) {
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

PoseHypothesis refine(const Field& f, const Start& start, const ConsensusOptions& o,
                      const Kernels& kernels) {
  MatchRange ranges[3];
  ranges_around(f, f.keys[start.index], ranges);
  PoseHypothesis pose = start.pose;
  // Far inliers are off by the error of the first yaw: the tolerance starts wide.
  for (const double factor : {2.0, 1.5, 1.0, 1.0}) {
    const auto inliers = distinct_inliers(f, ranges, pose, factor * o.inlier_tolerance,
                                          o.height_tolerance, kernels);
    if (inliers.size() < 2) break;
    fit(f, inliers, pose);
  }
  for (const Inlier& in :
       distinct_inliers(f, ranges, pose, o.inlier_tolerance, o.height_tolerance, kernels)) {
    ++pose.inliers;
    pose.score += 1.0 - in.squared / (o.inlier_tolerance * o.inlier_tolerance);
  }
  return pose;
}

bool explains(const PoseHypothesis& pose, const Field& f, const Start& start, double tolerance) {
  const std::size_t k = start.index;
  const double c = std::cos(pose.yaw), s = std::sin(pose.yaw);
  const double dx = c * f.qx[k] - s * f.qy[k] + pose.t[0] - f.mx[k];
  const double dy = s * f.qx[k] + c * f.qy[k] + pose.t[1] - f.my[k];
  return dx * dx + dy * dy <= tolerance * tolerance &&
         std::fabs(wrap(pose.yaw - start.pose.yaw)) < kSameStart;
}

bool same_place(const PoseHypothesis& a, const PoseHypothesis& b, double separation) {
  return std::hypot(a.t[0] - b.t[0], a.t[1] - b.t[1]) < separation &&
         std::fabs(wrap(a.yaw - b.yaw)) < kSameYaw;
}

}  // namespace

std::vector<PoseHypothesis> consensus(const double* query, std::size_t q, const double* map,
                                      const std::int64_t* mq, const std::int64_t* mm,
                                      std::size_t matches, const ConsensusOptions& o, int threads) {
  if (matches < 2) return {};
  // Map coordinates may be as large as UTM's: floats are taken relative to one of the matches.
  const double* origin = map + 3 * mm[0];
  const double reach = std::max(longest_edge(query, q) + o.inlier_tolerance, 1.0);
  const Field f = make_field({query, q, map, mq, mm, matches}, origin, o.distinct_radius, reach);

  const Kernels& kernel_table = kernels(parse_isa("auto"));
  PoseVotes votes = vote_for_poses(f, {o.inlier_tolerance, o.max_votes, o.max_cells}, threads);
  while (!votes.cells.empty() && votes.cells.back().votes < kShare * votes.cells.front().votes) {
    votes.cells.pop_back();
  }
  std::vector<Start> starts(votes.cells.size());
  parallel_for(starts.size(), 4, threads, [&](std::size_t begin, std::size_t end, int) {
    for (std::size_t i = begin; i < end; ++i) {
      starts[i] = best_start(f, votes.cells[i], votes, o, kernel_table);
    }
  });
  std::stable_sort(starts.begin(), starts.end(),
                   [](const Start& a, const Start& b) { return a.support > b.support; });

  std::vector<PoseHypothesis> refined;
  for (const Start& start : starts) {
    if (refined.size() >= o.max_refined || start.support == 0) break;
    const bool known = std::any_of(refined.begin(), refined.end(), [&](const PoseHypothesis& pose) {
      return explains(pose, f, start, o.inlier_tolerance);
    });
    if (!known) refined.push_back(refine(f, start, o, kernel_table));
  }
  std::stable_sort(refined.begin(), refined.end(), [](const auto& a, const auto& b) {
    return a.score > b.score;
  });
  std::vector<PoseHypothesis> distinct;
  for (const PoseHypothesis& pose : refined) {
    if (distinct.size() >= o.max_hypotheses) break;
    const bool known = std::any_of(distinct.begin(), distinct.end(), [&](const auto& other) {
      return same_place(pose, other, o.separation);
    });
    if (!known) distinct.push_back(pose);
  }
  for (PoseHypothesis& pose : distinct) {
    for (int a = 0; a < 3; ++a) pose.t[a] += origin[a];
  }
  return distinct;
}

}  // namespace segloc
