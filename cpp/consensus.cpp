#include "consensus.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <numeric>

#include "cells.h"
#include "kernels.h"
#include "parallel.h"

namespace segloc {
namespace {

constexpr double kPi = 3.14159265358979323846;
constexpr int kBins = 240;
constexpr double kBinWidth = 2.0 * kPi / kBins;
constexpr double kMaxVoteHalfWidth = 10.0 * kPi / 180.0;
constexpr double kSameYaw = 15.0 * kPi / 180.0;
constexpr std::size_t kBlock = 256;
constexpr std::size_t kMaxWidth = 16;

double wrap(double angle) { return angle - 2.0 * kPi * std::floor(angle / (2.0 * kPi) + 0.5); }

// Query segments that lie close together (the same object cut at two heights) are one witness.
std::vector<std::uint32_t> group_by_distance(const double* points, std::size_t n, double radius) {
  std::vector<std::uint32_t> group(n);
  std::uint32_t groups = 0;
  for (std::size_t i = 0; i < n; ++i) {
    group[i] = groups;
    for (std::size_t j = 0; j < i; ++j) {
      const double dx = points[3 * i] - points[3 * j], dy = points[3 * i + 1] - points[3 * j + 1];
      if (dx * dx + dy * dy < radius * radius) {
        group[i] = group[j];
        break;
      }
    }
    if (group[i] == groups) ++groups;
  }
  return group;
}

// Matches sorted by cell of the map plane; structure of arrays for the pair test.
struct Field {
  std::vector<float> qx, qy, qz, mx, my, mz;  // a vector's width longer than the matches
  std::vector<std::uint32_t> group, map_index;
  std::vector<std::uint64_t> keys;
  std::int64_t stride = 0;
  std::size_t groups = 0;
  double farthest = 0.0;  // largest coordinate

  std::size_t size() const { return group.size(); }
  MatchField columns() const {
    return {qx.data(), qy.data(), qz.data(), mx.data(), my.data(), mz.data()};
  }
};

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

Field make_field(const double* query, std::size_t q, const double* map, const std::int64_t* mq,
                 const std::int64_t* mm, std::size_t n, const double* origin, double distinct,
                 double reach) {
  std::vector<float> plane(3 * n, 0.0f);
  for (std::size_t k = 0; k < n; ++k) {
    for (int a = 0; a < 2; ++a) plane[3 * k + a] = static_cast<float>(map[3 * mm[k] + a] - origin[a]);
  }
  CellOrder cells = sort_into_cells(plane.data(), n, reach);
  const std::vector<std::uint32_t> group = group_by_distance(query, q, distinct);
  Field f;
  f.keys = std::move(cells.keys);
  f.stride = cells.stride_y;
  f.groups = q == 0 ? 0 : 1 + *std::max_element(group.begin(), group.end());
  for (const std::uint32_t k : cells.order) {
    const double *a = query + 3 * mq[k], *b = map + 3 * mm[k];
    f.qx.push_back(static_cast<float>(a[0]));
    f.qy.push_back(static_cast<float>(a[1]));
    f.qz.push_back(static_cast<float>(a[2]));
    f.mx.push_back(static_cast<float>(b[0] - origin[0]));
    f.my.push_back(static_cast<float>(b[1] - origin[1]));
    f.mz.push_back(static_cast<float>(b[2] - origin[2]));
    f.group.push_back(group[static_cast<std::size_t>(mq[k])]);
    f.map_index.push_back(static_cast<std::uint32_t>(mm[k]));
  }
  for (std::vector<float>* column : {&f.qx, &f.qy, &f.qz, &f.mx, &f.my, &f.mz}) {
    for (const float v : *column) f.farthest = std::max<double>(f.farthest, std::fabs(v));
    column->resize(n + kMaxWidth, 0.0f);
  }
  return f;
}

struct Range {
  std::size_t begin, end;
};

// The matches in the three by three cells around a key: three ranges of the sorted field.
void ranges_around(const Field& f, std::uint64_t key, Range ranges[3]) {
  for (int dy = -1; dy <= 1; ++dy) {
    const auto row = key + static_cast<std::uint64_t>(dy * f.stride);
    const auto begin = std::lower_bound(f.keys.begin(), f.keys.end(), row - 1);
    const auto end = std::upper_bound(begin, f.keys.end(), row + 1);
    ranges[dy + 1] = {static_cast<std::size_t>(begin - f.keys.begin()),
                      static_cast<std::size_t>(end - f.keys.begin())};
  }
}

// Distinct objects for every bin of yaw, as bit sets.
class YawVotes {
 public:
  explicit YawVotes(std::size_t groups) : words_((groups + 63) / 64), bits_(kBins * words_) {}

  void clear() {
    for (const int bin : touched_) {
      counts_[bin] = 0;
      std::fill_n(bits_.begin() + static_cast<std::ptrdiff_t>(bin * words_), words_, 0);
    }
    touched_.clear();
  }

  void add(double yaw, double half_width, std::uint32_t group) {
    const int low = static_cast<int>(std::floor((yaw - half_width + kPi) / kBinWidth));
    const int high = static_cast<int>(std::floor((yaw + half_width + kPi) / kBinWidth));
    for (int b = low; b <= high; ++b) {
      const int bin = (b + kBins) % kBins;
      std::uint64_t& word = bits_[static_cast<std::size_t>(bin) * words_ + group / 64];
      const std::uint64_t bit = std::uint64_t{1} << (group % 64);
      if ((word & bit) != 0) continue;
      word |= bit;
      if (counts_[bin]++ == 0) touched_.push_back(bin);
    }
  }

  // The middle of the first longest run of best bins.
  double best(std::size_t& count) const {
    const int top = *std::max_element(counts_.begin(), counts_.end());
    int at = 0, length = 0;
    for (const int b : touched_) {
      const bool starts = counts_[b] == top && counts_[(b + kBins - 1) % kBins] != top;
      if (!starts) continue;
      int run = 1;
      while (counts_[(b + run) % kBins] == top) ++run;
      if (run > length || (run == length && b < at)) {
        at = b;
        length = run;
      }
    }
    count = static_cast<std::size_t>(top);
    if (length == 0) length = kBins;  // all bins are best: there is no start
    return wrap((at + 0.5 * length) * kBinWidth - kPi);
  }

 private:
  std::size_t words_;
  std::vector<std::uint64_t> bits_;
  std::array<int, kBins> counts_{};
  std::vector<int> touched_;
};

struct Pivot {
  std::size_t index = 0, support = 0;
  double yaw = 0.0;
};

Pivot vote(const Field& f, std::size_t i, const ConsensusOptions& o, const Kernels& kernels,
           YawVotes& votes) {
  Range ranges[3];
  ranges_around(f, f.keys[i], ranges);
  const EdgeTest test{i, static_cast<float>(o.edge_tolerance * o.edge_tolerance),
                      static_cast<float>(o.min_edge * o.min_edge),
                      static_cast<float>(o.height_tolerance)};
  const MatchField columns = f.columns();
  std::uint32_t agreeing[kBlock];
  votes.clear();
  bool any = false;
  for (const Range& range : ranges) {
    for (std::size_t begin = range.begin; begin < range.end; begin += kBlock) {
      const std::size_t end = std::min(begin + kBlock, range.end);
      const std::size_t count = kernels.equal_edges(columns, test, begin, end, agreeing);
      for (std::size_t k = 0; k < count; ++k) {
        const std::size_t j = agreeing[k];
        if (f.group[j] == f.group[i]) continue;
        any = true;
        const double ax = f.qx[j] - f.qx[i], ay = f.qy[j] - f.qy[i];
        const double bx = f.mx[j] - f.mx[i], by = f.my[j] - f.my[i];
        const double yaw = std::atan2(ax * by - ay * bx, ax * bx + ay * by);
        const double half = std::atan(o.edge_tolerance / std::sqrt(ax * ax + ay * ay));
        votes.add(yaw, std::min(half, kMaxVoteHalfWidth), f.group[j]);
      }
    }
  }
  Pivot pivot;
  pivot.index = i;
  if (any) pivot.yaw = votes.best(pivot.support);
  return pivot;
}

struct Inlier {
  std::size_t match;
  double squared;  // horizontal distance
};

// One match for each object of the query and each segment of the map, nearest first.
std::vector<Inlier> distinct_inliers(const Field& f, const Range ranges[3],
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
  for (const Inlier& candidate : near) {
    const bool taken = std::any_of(kept.begin(), kept.end(), [&](const Inlier& other) {
      return f.group[other.match] == f.group[candidate.match] ||
             f.map_index[other.match] == f.map_index[candidate.match];
    });
    if (!taken) kept.push_back(candidate);
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

PoseHypothesis refine(const Field& f, const Pivot& pivot, const ConsensusOptions& o,
                      const Kernels& kernels) {
  Range ranges[3];
  ranges_around(f, f.keys[pivot.index], ranges);
  PoseHypothesis pose;
  pose.yaw = pivot.yaw;
  fit(f, {{pivot.index, 0.0}}, pose);
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

bool explains(const PoseHypothesis& pose, const Field& f, const Pivot& pivot, double tolerance) {
  const std::size_t k = pivot.index;
  const double c = std::cos(pose.yaw), s = std::sin(pose.yaw);
  const double dx = c * f.qx[k] - s * f.qy[k] + pose.t[0] - f.mx[k];
  const double dy = s * f.qx[k] + c * f.qy[k] + pose.t[1] - f.my[k];
  return dx * dx + dy * dy <= tolerance * tolerance &&
         std::fabs(wrap(pose.yaw - pivot.yaw)) < kSameYaw;
}

bool same_place(const PoseHypothesis& a, const PoseHypothesis& b, double separation) {
  return std::hypot(a.t[0] - b.t[0], a.t[1] - b.t[1]) < separation &&
         std::fabs(wrap(a.yaw - b.yaw)) < kSameYaw;
}

}  // namespace

std::vector<PoseHypothesis> pair_consensus(const double* query, std::size_t q, const double* map,
                                           const std::int64_t* mq, const std::int64_t* mm,
                                           std::size_t matches, const ConsensusOptions& o,
                                           int threads) {
  if (matches < 2) return {};
  // Map coordinates may be as large as UTM's: floats are taken relative to one of the matches.
  const double* origin = map + 3 * mm[0];
  const double reach = std::max(longest_edge(query, q) + o.edge_tolerance, 1.0);
  const Field f = make_field(query, q, map, mq, mm, matches, origin, o.distinct_radius, reach);

  const Kernels& kernel_table = kernels(parse_isa("auto"));
  std::vector<Pivot> pivots(f.size());
  std::vector<YawVotes> votes(static_cast<std::size_t>(resolve_threads(threads)), YawVotes(f.groups));
  parallel_for(f.size(), 64, threads, [&](std::size_t begin, std::size_t end, int worker) {
    for (std::size_t i = begin; i < end; ++i) {
      pivots[i] = vote(f, i, o, kernel_table, votes[static_cast<std::size_t>(worker)]);
    }
  });
  std::stable_sort(pivots.begin(), pivots.end(),
                   [](const Pivot& a, const Pivot& b) { return a.support > b.support; });

  std::vector<PoseHypothesis> refined;
  for (const Pivot& pivot : pivots) {
    if (refined.size() >= o.max_pivots || pivot.support == 0) break;
    const bool known = std::any_of(refined.begin(), refined.end(), [&](const PoseHypothesis& pose) {
      return explains(pose, f, pivot, 2.0 * o.inlier_tolerance);
    });
    if (!known) refined.push_back(refine(f, pivot, o, kernel_table));
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
