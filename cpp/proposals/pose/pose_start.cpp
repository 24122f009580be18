#include "proposals/pose/pose_start.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <vector>

namespace segloc {
namespace {

constexpr int kFineSteps = 6;     // that a step of yaw is divided into
constexpr double kTypical = 0.7;  // share of the tolerance that most matches keep
constexpr std::size_t kBlock = 256;
constexpr std::size_t kMostLevels = 8;
constexpr std::size_t kFewestObjects = 2;  // that agree on another height than most do

// The matches that a cell of poses gathers, one object after another.
std::vector<std::uint32_t> gather(const MatchTable& f, const PoseCell& cell, double width,
                                  const Kernels& kernels) {
  const double reach = std::sqrt(1.5) * width;
  const PoseTest test{static_cast<float>(std::cos(cell.yaw)),
                      static_cast<float>(std::sin(cell.yaw)), static_cast<float>(cell.x),
                      static_cast<float>(cell.y), static_cast<float>(reach * reach)};
  std::vector<std::uint32_t> gathered;
  std::uint32_t close[kBlock];
  for (const MatchRange& range : ranges_near(f, test, reach)) {
    for (std::size_t begin = range.begin; begin < range.end; begin += kBlock) {
      const std::size_t end = std::min(begin + kBlock, range.end);
      const std::size_t count = kernels.near_pose(f.arrays(), test, begin, end, close);
      gathered.insert(gathered.end(), close, close + count);
    }
  }
  std::stable_sort(gathered.begin(), gathered.end(),
                   [&](std::uint32_t a, std::uint32_t b) { return f.group[a] < f.group[b]; });
  return gathered;
}

// Votes on a few square metres of translations at one yaw. Voters come one object after another.
class FineVotes {
 public:
  FineVotes(double x, double y, double radius, double width)
      : x_(x - radius),
        y_(y - radius),
        width_(width),
        per_metre_(1.0 / width),
        side_(static_cast<int>(2.0 * radius / width) + 2),
        stride_(side_ + 2),
        counters_(static_cast<std::size_t>(stride_ * stride_)) {}

  void clear() { std::fill(counters_.begin(), counters_.end(), Counter{}); }

  void add(double x, double y, std::uint32_t group) {
    const int first = cell_of(x, y);
    if (first < 0) return;
    // A margin of one cell on each side, so that all four corners exist.
    for (const int at : {first, first + 1, first + stride_, first + stride_ + 1}) {
      Counter& counter = counters_[static_cast<std::size_t>(at)];
      counter.votes += counter.group != group;
      counter.group = group;
    }
  }

  // Whether some cell has more votes than the start; which then is moved there.
  bool improve(PoseStart& start) {
    std::size_t best = start.support;
    int column = -1, row = -1;
    for (int j = 1; j <= side_; ++j) {
      for (int i = 1; i <= side_; ++i) {
        const Counter& counter = counters_[static_cast<std::size_t>(j * stride_ + i)];
        if (counter.votes <= best) continue;
        best = counter.votes, column = i - 1, row = j - 1;
      }
    }
    if (column < 0) return false;
    start.support = best;
    start.pose.t[0] = x_ + width_ * column;
    start.pose.t[1] = y_ + width_ * row;
    best_ = (row + 1) * stride_ + column + 1;
    return true;
  }

  // Whether a voter votes for the cell that improved the start.
  bool in_best(double x, double y) const {
    const int first = cell_of(x, y), steps = best_ - first;
    return first >= 0 && (steps == 0 || steps == 1 || steps == stride_ || steps == stride_ + 1);
  }

 private:
  struct Counter {
    std::uint32_t votes = 0, group = ~0u;  // the last object
  };

  // The first of the four cells that a voter votes for; -1 if they are out of the square.
  int cell_of(double x, double y) const {
    const double u = (x - x_) * per_metre_ + 1.0, v = (y - y_) * per_metre_ + 1.0;
    if (!(u >= 0.0 && v >= 0.0 && u <= side_ && v <= side_)) return -1;
    return static_cast<int>(v) * stride_ + static_cast<int>(u);
  }

  double x_, y_, width_, per_metre_;
  int side_, stride_, best_ = -1;
  std::vector<Counter> counters_;
};

struct Height {
  float z;
  std::uint32_t group;
};

// How much higher the map is than the query by each match that agrees with a pose, sorted.
std::vector<Height> heights_of(const MatchTable& f, const std::vector<std::uint32_t>& matches,
                               const PoseHypothesis& pose, double radius) {
  const double c = std::cos(pose.yaw), s = std::sin(pose.yaw);
  std::vector<Height> heights;
  for (const std::uint32_t k : matches) {
    const double dx = c * f.qx[k] - s * f.qy[k] + pose.t[0] - f.mx[k];
    const double dy = s * f.qx[k] + c * f.qy[k] + pose.t[1] - f.my[k];
    if (dx * dx + dy * dy <= radius * radius) heights.push_back({f.mz[k] - f.qz[k], f.group[k]});
  }
  std::stable_sort(heights.begin(), heights.end(),
                   [](const Height& a, const Height& b) { return a.z < b.z; });
  return heights;
}

struct Level {
  std::size_t objects = 0;
  double z = 0.0;
};

// The height that most objects agree on, within the tolerance up and down.
Level commonest(const std::vector<Height>& heights, double tolerance) {
  Level best;
  std::vector<std::uint32_t> groups;
  for (std::size_t begin = 0, end = 0; begin < heights.size(); ++begin) {
    const double last = heights[begin].z + 2.0 * tolerance;
    while (end < heights.size() && heights[end].z <= last) ++end;
    if (end - begin <= best.objects) continue;
    groups.clear();
    for (std::size_t k = begin; k < end; ++k) groups.push_back(heights[k].group);
    std::sort(groups.begin(), groups.end());
    const auto objects =
        static_cast<std::size_t>(std::unique(groups.begin(), groups.end()) - groups.begin());
    if (objects > best.objects) best = {objects, heights[(begin + end) / 2].z};
  }
  return best;
}

// The levels that matches agree on, the commonest first; each as far from the others as poses must
// be to have no match in common.
std::vector<Level> levels_of(std::vector<Height> heights, double tolerance) {
  std::vector<Level> levels;
  while (levels.size() < kMostLevels) {
    const Level level = commonest(heights, tolerance);
    if (level.objects < (levels.empty() ? 1 : kFewestObjects)) break;
    levels.push_back(level);
    heights.erase(std::remove_if(
                      heights.begin(), heights.end(),
                      [&](const Height& h) { return std::fabs(h.z - level.z) <= 2.0 * tolerance; }),
                  heights.end());
  }
  return levels;
}

}  // namespace

std::vector<PoseStart> best_starts(const MatchTable& f, const PoseCell& cell,
                                   const PoseVotes& votes, const ConsensusOptions& o,
                                   const Kernels& kernels) {
  const std::vector<std::uint32_t> matches = gather(f, cell, votes.width, kernels);
  const double turn = votes.turn / kFineSteps;
  const double width = 2.0 * (kTypical * o.inlier_tolerance + 0.5 * turn * votes.radius);
  // The query turns about its middle, as it did in the coarse vote.
  const double c0 = std::cos(cell.yaw), s0 = std::sin(cell.yaw);
  const double middle[2] = {c0 * votes.middle[0] - s0 * votes.middle[1] + cell.x,
                            s0 * votes.middle[0] + c0 * votes.middle[1] + cell.y};
  FineVotes fine(middle[0], middle[1], votes.width, width);
  const auto translation = [&](std::uint32_t k, double c, double s) {  // that a match implies
    const double x = f.qx[k] - votes.middle[0], y = f.qy[k] - votes.middle[1];
    return std::array<double, 2>{f.mx[k] - (c * x - s * y), f.my[k] - (s * x + c * y)};
  };
  PoseStart start;
  for (int step = 0; step <= kFineSteps; ++step) {
    const double yaw = cell.yaw + (step - 0.5 * kFineSteps) * turn;
    const double c = std::cos(yaw), s = std::sin(yaw);
    fine.clear();
    for (const std::uint32_t k : matches) {
      const auto [x, y] = translation(k, c, s);
      fine.add(x, y, f.group[k]);
    }
    if (fine.improve(start)) start.pose.yaw = yaw;
  }
  const double c = std::cos(start.pose.yaw), s = std::sin(start.pose.yaw);
  std::uint32_t group = ~0u;
  for (const std::uint32_t k : matches) {  // the first of the last object
    const auto [x, y] = translation(k, c, s);
    if (f.group[k] == group || !fine.in_best(x, y)) continue;
    start.index = k;
    group = f.group[k];
  }
  start.pose.t[0] -= c * votes.middle[0] - s * votes.middle[1];
  start.pose.t[1] -= s * votes.middle[0] + c * votes.middle[1];
  std::vector<PoseStart> starts;
  for (const Level& level :
       levels_of(heights_of(f, matches, start.pose, width), o.height_tolerance)) {
    starts.push_back(start);
    starts.back().pose.t[2] = level.z;
    if (starts.size() > 1) starts.back().support = level.objects;
  }
  if (starts.empty()) starts.push_back(start);
  return starts;
}

}  // namespace segloc
