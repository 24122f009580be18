#include "proposals/occupancy/pose_search.h"

#include <algorithm>
#include <cmath>
#include <tuple>
#include <utility>

#include "common/angles.h"
#include "proposals/occupancy/bounds.h"

namespace segloc {
namespace {

// Parts are first scored with some columns; this multiple of `width` of them with all columns.
// At the last level fewer: an eighth of `width`, or a multiple of the poses wanted.
constexpr std::size_t kOfParts = 2, kLastOf = 8, kOfPoses = 32;

// Whether a window, from cell (x, y) on, has a place that is near enough.
bool meets(const SearchLimits& limits, double cell, std::int32_t x, std::int32_t y,
           std::int32_t side) {
  const auto beyond = [&](double at, std::int32_t first) {  // of an edge of the window
    return std::max({first * cell - at, at - (first + side) * cell, 0.0});
  };
  return std::hypot(beyond(limits.x, x), beyond(limits.y, y)) <= limits.radius;
}

// The widest windows that are looked at, and their scores at each turn.
class WidestWindows {
 public:
  WidestWindows(const SearchArea& area, const Bounds& bounds, const SearchLimits& limits)
      : side_(1 << (area.map().levels() - 1)), held_(turns(limits)), score_(turns(limits)) {
    std::vector<std::size_t> runs;  // that hold any
    area.visit([&](std::size_t run, std::size_t j, std::int32_t x, std::int32_t y) {
      if (meets(limits, area.map().cell(), x * side_, y * side_, side_)) {
        if (runs.empty() || runs.back() != run) runs.push_back(run);
        windows_.push_back({(runs.size() - 1) * SearchArea::kRun + j, x * side_, y * side_});
      }
    });
    for (std::size_t k = 0; k < held_.size(); ++k) bounds.all(runs, k, held_[k], score_[k]);
  }

  // The best, by what they hold alone or less the cost of free places.
  std::vector<Branch> best(bool costly, std::size_t most, std::size_t width) const {
    const auto& scores = costly ? score_ : held_;
    std::vector<std::size_t> histogram(most + 1, 0);
    for (const auto& at_turn : scores) {
      for (const Window& window : windows_) ++histogram[at_turn[window.place]];
    }
    std::size_t least = most, better = 0;
    while (least > 0 && better + histogram[least] <= width) better += histogram[least--];
    std::size_t equal = width - better;
    std::vector<Branch> branches;
    for (std::uint32_t k = 0; k < scores.size(); ++k) {
      for (const Window& window : windows_) {
        const std::uint16_t s = scores[k][window.place];
        if (s < least || (s == least && equal == 0)) continue;
        if (s == least) --equal;
        branches.push_back({float(s), 0, k, window.x, window.y});
      }
    }
    return branches;
  }

 private:
  struct Window {
    std::size_t place;  // among the scores
    std::int32_t x, y;  // first cell
  };

  std::int32_t side_;
  std::vector<Window> windows_;
  std::vector<std::vector<std::uint16_t>> held_, score_;
};

void keep_best(std::vector<Branch>& branches, std::size_t width) {
  if (branches.size() <= width) return;
  std::nth_element(branches.begin(), branches.begin() + static_cast<std::ptrdiff_t>(width),
                   branches.end());
  branches.resize(width);
}

// In an order in which those near each other follow one another: what they read is then at hand.
void by_place(std::vector<Branch>& branches) {
  const auto place = [](const Branch& b) { return std::make_tuple(b.y >> 5, b.x >> 5, b.yaw); };
  std::sort(branches.begin(), branches.end(),
            [&](const Branch& a, const Branch& b) { return place(a) < place(b); });
}

// Each of the widest windows at all headings of its turn.
std::vector<Branch> at_headings(const std::vector<Branch>& branches, const SearchLimits& limits) {
  std::vector<Branch> found;
  found.reserve(kTurned * branches.size());
  for (Branch b : branches) {
    const std::size_t first = kTurned * b.yaw, last = std::min(first + kTurned, limits.yaws);
    for (std::size_t k = first; k < last; ++k) {
      b.yaw = static_cast<std::uint32_t>(k);
      found.push_back(b);
    }
  }
  return found;
}

// The four quarters of each window, without scores.
std::vector<Branch> divided(const std::vector<Branch>& branches, int level) {
  std::vector<Branch> parts;
  parts.reserve(4 * branches.size());
  const std::int32_t half = 1 << level;
  for (const Branch& b : branches) {
    for (const std::int32_t y : {b.y, b.y + half}) {
      for (const std::int32_t x : {b.x, b.x + half}) parts.push_back({0.0f, 0, b.yaw, x, y});
    }
  }
  return parts;
}

bool alike(const PlanarPose& a, const PlanarPose& b, const SearchLimits& limits) {
  if (a.x == b.x && a.y == b.y && a.yaw == b.yaw) return true;
  if (!(std::hypot(a.x - b.x, a.y - b.y) < limits.separation)) return false;
  return std::abs(std::remainder(a.yaw - b.yaw, 2.0 * kPi)) * 180.0 / kPi < limits.separation_deg;
}

// A leaf's pose, to a fraction of its window: the mean of the windows and headings about it, begun
// a cell and turned a step apart, that hold the most.
PlanarPose centred(const Branch& leaf, const Bounds& bounds, double cell,
                   const SearchLimits& limits) {
  std::uint32_t most = 0;
  double ties = 0, x = 0, y = 0, turn = 0;
  for (int step = 0; step < 27; ++step) {
    const int dx = step % 3 - 1, dy = step / 3 % 3 - 1, dk = step / 9 - 1;
    const int yaw = (int(leaf.yaw) + dk + int(limits.yaws)) % int(limits.yaws);
    const Branch other{0.0f, 0, static_cast<std::uint32_t>(yaw), leaf.x + dx, leaf.y + dy};
    const std::uint32_t score = bounds.held(limits.leaf_level, other);
    if (score < most) continue;
    if (score > most) most = score, ties = x = y = turn = 0;
    ++ties, x += dx, y += dy, turn += dk;
  }
  // A column falls half a cell, on average, past the cell that it begins in.
  const double middle = 0.5 * (double(1 << limits.leaf_level) - 1.0);
  return {(leaf.x + x / ties + middle) * cell, (leaf.y + y / ties + middle) * cell,
          angle(leaf.yaw, limits) + turn / ties * angle(1, limits),
          bounds.score(limits.leaf_level, leaf)};
}

// Adds the best leaves up to a total, each distinct from those already there.
void add_apart(std::vector<Branch>& leaves, const Bounds& bounds, double cell, std::size_t count,
               const SearchLimits& limits, std::vector<PlanarPose>& middles,
               std::vector<PlanarPose>& poses) {
  std::sort(leaves.begin(), leaves.end());
  const double middle = 0.5 * double(1 << limits.leaf_level);
  for (const Branch& b : leaves) {
    if (poses.size() == count) break;
    const PlanarPose pose{(b.x + middle) * cell, (b.y + middle) * cell, angle(b.yaw, limits), 0.0f};
    if (std::hypot(pose.x - limits.x, pose.y - limits.y) > limits.radius) continue;
    const auto like = [&](const PlanarPose& other) { return alike(pose, other, limits); };
    if (std::any_of(middles.begin(), middles.end(), like)) continue;
    middles.push_back(pose);
    poses.push_back(centred(b, bounds, cell, limits));
  }
}

// The windows divided down to leaves.
std::vector<Branch> leaves(std::vector<Branch> branches, int top, const Bounds& bounds, bool costly,
                           std::size_t width, const SearchLimits& limits) {
  branches = at_headings(branches, limits);
  for (int level = top - 1; level >= limits.leaf_level; --level) {
    by_place(branches);
    std::vector<Branch> parts = divided(branches, level);
    for (std::size_t k = 0; k < parts.size(); k += 4) bounds.roughly(level, &parts[k], costly);
    const bool last = level == limits.leaf_level;
    keep_best(parts, last ? std::max(width / kLastOf, kOfPoses * limits.count) : kOfParts * width);
    by_place(parts);
    for (Branch& part : parts) bounds.finish(level, part, costly);
    if (!last) keep_best(parts, width);
    branches = std::move(parts);
  }
  return branches;
}

}  // namespace

std::vector<PlanarPose> SearchArea::search(const PlanarView& view,
                                           const SearchLimits& limits) const {
  const Bounds bounds(*this, view, limits);
  const WidestWindows widest(*this, bounds, limits);
  const std::size_t passes = view.f > 0 ? 2 : 1;
  const std::size_t width = (limits.width + passes - 1) / passes;
  std::vector<PlanarPose> middles, poses;
  for (std::size_t pass = 1; pass <= passes; ++pass) {
    const bool costly = pass < passes;
    std::vector<Branch> found = leaves(widest.best(costly, bounds.most(), width), map_.levels() - 1,
                                       bounds, costly, width, limits);
    const std::size_t count = costly ? (limits.count + 1) / 2 : limits.count;
    add_apart(found, bounds, map_.cell(), count, limits, middles, poses);
  }
  std::stable_sort(poses.begin(), poses.end(),
                   [](const PlanarPose& a, const PlanarPose& b) { return a.score > b.score; });
  return poses;
}

}  // namespace segloc
