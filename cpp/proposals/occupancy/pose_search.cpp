#include "proposals/occupancy/pose_search.h"

#include <algorithm>
#include <cmath>
#include <tuple>
#include <utility>

#include "proposals/occupancy/bounds.h"

namespace segloc {
namespace {

constexpr double kPi = 3.14159265358979323846;

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

// What is scored on average for what the map has seen: at its edge less of a view can be held.
float usual_of(const std::vector<float>& scores, const std::vector<float>& seen) {
  double score = 0.0, of = 0.0;
  for (std::size_t i = 0; i < scores.size(); ++i) score += scores[i], of += seen[i];
  return static_cast<float>(score / std::max(of, 1e-3));
}

// The widest windows that are looked at, at each turn.
class WidestWindows {
 public:
  WidestWindows(const SearchArea& area, const Bounds& bounds, const SearchLimits& limits)
      : side_(1 << (area.map().levels() - 1)), each_(bounds.each()) {
    std::vector<std::size_t> runs;  // that hold any
    area.visit([&](std::size_t run, std::size_t j, std::int32_t x, std::int32_t y) {
      if (meets(limits, area.map().cell(), x * side_, y * side_, side_)) {
        if (runs.empty() || runs.back() != run) runs.push_back(run);
        windows_.push_back({(runs.size() - 1) * SearchArea::kRun + j, x * side_, y * side_});
      }
    });
    for (std::size_t k = 0; k < turns(limits); ++k) turns_.push_back(bounds.all(runs, k));
  }

  // The best, by what they hold alone, or less the cost of free places and what is usual.
  std::vector<Branch> best(bool costly, std::size_t width) const {
    const std::vector<std::uint16_t> scores = costly ? beyond_usual() : held();
    std::vector<std::size_t> histogram(kScores, 0);
    for (const std::uint16_t score : scores) ++histogram[score];
    std::size_t least = kScores - 1, better = 0;
    while (least > 0 && better + histogram[least] <= width) better += histogram[least--];
    std::size_t equal = width - better;
    std::vector<Branch> branches;
    for (std::size_t i = 0; i < scores.size(); ++i) {
      if (scores[i] < least || (scores[i] == least && equal == 0)) continue;
      if (scores[i] == least) --equal;
      const Window& window = windows_[i % windows_.size()];
      const auto turn = static_cast<std::uint32_t>(i / windows_.size());
      branches.push_back({turn, window.x, window.y});
    }
    return branches;
  }

 private:
  static constexpr std::size_t kScores = std::size_t{1} << 16;
  struct Window {
    std::size_t place;  // among those of a turn
    std::int32_t x, y;  // first cell
  };

  // Scores of all windows, turn by turn.
  std::vector<std::uint16_t> held() const {
    std::vector<std::uint16_t> found;
    found.reserve(turns_.size() * windows_.size());
    for (const Bounds::Windows& at : turns_) {
      for (const Window& window : windows_) found.push_back(at.held[window.place]);
    }
    return found;
  }
  // From the middle of the numbers on.
  std::vector<std::uint16_t> beyond_usual() const {
    std::vector<float> scores, seen;
    for (std::vector<float>* each : {&scores, &seen}) each->reserve(turns_.size() * windows_.size());
    for (const Bounds::Windows& at : turns_) {
      for (const Window& window : windows_) {
        scores.push_back(float(at.held[window.place]) - each_ * float(at.blocked[window.place]));
        seen.push_back(float(at.seen[window.place]));
      }
    }
    const float usual = usual_of(scores, seen);
    std::vector<std::uint16_t> found;
    found.reserve(scores.size());
    for (std::size_t i = 0; i < scores.size(); ++i) {
      const float score = scores[i] - usual * seen[i] + float(kScores / 2);
      found.push_back(static_cast<std::uint16_t>(std::clamp(score, 0.0f, float(kScores - 1))));
    }
    return found;
  }

  std::int32_t side_;
  float each_;
  std::vector<Window> windows_;
  std::vector<Bounds::Windows> turns_;
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
std::vector<Branch> at_headings(const std::vector<Branch>& branches, int level,
                                const Bounds& bounds, const SearchLimits& limits) {
  std::vector<Branch> found;
  found.reserve(kTurned * branches.size());
  for (Branch b : branches) {
    const std::size_t first = kTurned * b.yaw, last = std::min(first + kTurned, limits.yaws);
    for (std::size_t k = first; k < last; ++k) {
      b.yaw = static_cast<std::uint32_t>(k);
      b.seen = bounds.seen(level, b);
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
      for (const std::int32_t x : {b.x, b.x + half}) parts.push_back({b.yaw, x, y, b.seen});
    }
  }
  return parts;
}

// Ranks by the score, or by what of it is beyond the usual.
void rank(std::vector<Branch>& branches, bool beyond) {
  std::vector<float> scores, seen;
  for (const Branch& b : branches) scores.push_back(b.score), seen.push_back(b.seen);
  const float usual = beyond ? usual_of(scores, seen) : 0.0f;
  for (Branch& b : branches) b.rank = b.score - usual * b.seen;
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
    const auto yaw = static_cast<std::uint32_t>(int(leaf.yaw) + dk + int(limits.yaws)) %
                     static_cast<std::uint32_t>(limits.yaws);
    const Branch other{yaw, leaf.x + dx, leaf.y + dy};
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

// A place, and the leaf there that holds the most.
struct Place {
  PlanarPose middle;
  Branch leaf;
};

// Adds the places of the best leaves up to a total, each distinct from those already there.
void add_apart(std::vector<Branch>& leaves, double cell, std::size_t count,
               const SearchLimits& limits, std::vector<Place>& places) {
  std::sort(leaves.begin(), leaves.end());
  const double middle = 0.5 * double(1 << limits.leaf_level);
  for (const Branch& b : leaves) {
    const PlanarPose pose{(b.x + middle) * cell, (b.y + middle) * cell, angle(b.yaw, limits), 0.0f};
    if (std::hypot(pose.x - limits.x, pose.y - limits.y) > limits.radius) continue;
    const auto like = std::find_if(places.begin(), places.end(), [&](const Place& other) {
      return alike(pose, other.middle, limits);
    });
    if (like != places.end()) {
      if (b.held > like->leaf.held) like->leaf = b;
    } else if (places.size() < count) {
      places.push_back({pose, b});
    }
  }
}

// The windows divided down to leaves.
std::vector<Branch> leaves(std::vector<Branch> branches, int top, const Bounds& bounds, bool costly,
                           std::size_t width, const SearchLimits& limits) {
  branches = at_headings(branches, top, bounds, limits);
  for (int level = top - 1; level >= limits.leaf_level; --level) {
    by_place(branches);
    std::vector<Branch> parts = divided(branches, level);
    for (std::size_t k = 0; k < parts.size(); k += 4) bounds.roughly(level, &parts[k], costly);
    rank(parts, costly);
    const bool last = level == limits.leaf_level;
    keep_best(parts, last ? std::max(width / kLastOf, kOfPoses * limits.count) : kOfParts * width);
    by_place(parts);
    for (Branch& part : parts) bounds.finish(level, part, costly);
    rank(parts, costly);
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
  std::vector<Place> places;
  for (std::size_t pass = 1; pass <= passes; ++pass) {
    const bool costly = pass < passes;
    std::vector<Branch> found = leaves(widest.best(costly, width), map_.levels() - 1, bounds, costly,
                                       width, limits);
    const std::size_t count = costly ? (limits.count + 1) / 2 : limits.count;
    add_apart(found, map_.cell(), count, limits, places);
  }
  std::vector<PlanarPose> poses;
  for (const Place& place : places) {
    poses.push_back(centred(place.leaf, bounds, map_.cell(), limits));
  }
  std::stable_sort(poses.begin(), poses.end(),
                   [](const PlanarPose& a, const PlanarPose& b) { return a.score > b.score; });
  return poses;
}

}  // namespace segloc
