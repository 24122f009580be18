#include "occupancy/pose_search.h"

#include <algorithm>
#include <cmath>
#include <tuple>
#include <utility>

#include "common/portability.h"

namespace segloc {
namespace {

constexpr double kPi = 3.14159265358979323846;

struct Branch {
  std::uint32_t score;
  std::uint32_t yaw;
  std::int32_t x, y;  // first cell of its window

  bool operator<(const Branch& other) const {  // the better one first
    return std::tie(other.score, yaw, y, x) < std::tie(score, other.yaw, other.y, other.x);
  }
};

// Parts are scored with some of the columns first; so many times `width` of them with all.
// In the end fewer: an eighth of `width`, or so many times the poses that are wanted.
constexpr std::size_t kOneOf = 4, kOfParts = 2, kLastOf = 8, kOfPoses = 32;

// The bits of each byte.
struct BitCounts {
  std::uint8_t of[256] = {};
  constexpr BitCounts() {
    for (int v = 1; v < 256; ++v) of[v] = static_cast<std::uint8_t>((v & 1) + of[v / 2]);
  }
};
constexpr BitCounts kOnes;

double angle(std::size_t k, const SearchLimits& limits) {
  return 2.0 * kPi * double(k) / double(limits.yaws);
}

// What the query's columns become at each heading, in cells.
std::vector<std::int32_t> turned(const float* columns, std::size_t m, double cell,
                                 const SearchLimits& limits) {
  std::vector<std::int32_t> offsets(2 * m * limits.yaws);
  auto* next = offsets.data();
  for (std::size_t k = 0; k < limits.yaws; ++k) {
    const double c = std::cos(angle(k, limits)), s = std::sin(angle(k, limits));
    for (std::size_t i = 0; i < m; ++i) {
      const double x = columns[2 * i], y = columns[2 * i + 1];
      *next++ = static_cast<std::int32_t>(std::floor((c * x - s * y) / cell));
      *next++ = static_cast<std::int32_t>(std::floor((s * x + c * y) / cell));
    }
  }
  return offsets;
}

// Whether a window, from cell (x, y) on, has a place that is near enough.
bool meets(const SearchLimits& limits, double cell, std::int32_t x, std::int32_t y,
           std::int32_t side) {
  const auto beyond = [&](double at, std::int32_t first) {  // of an edge of the window
    return std::max({first * cell - at, at - (first + side) * cell, 0.0});
  };
  return std::hypot(beyond(limits.x, x), beyond(limits.y, y)) <= limits.radius;
}

struct Window {
  std::size_t place;  // among the scores
  std::int32_t x, y;
};

// The best of all windows at all headings.
std::vector<Branch> best_windows(const SearchArea& area, const std::vector<std::int32_t>& offsets,
                                 const std::uint8_t* slices, std::size_t m,
                                 const SearchLimits& limits) {
  std::vector<std::vector<std::uint16_t>> scores(limits.yaws);
  std::vector<std::size_t> histogram(8 * m + 1, 0);
  const std::int32_t side = 1 << (area.map().levels() - 1);
  std::vector<Window> windows;
  area.visit([&](std::size_t i, std::int32_t x, std::int32_t y) {
    if (meets(limits, area.map().cell(), x * side, y * side, side)) windows.push_back({i, x, y});
  });
  for (std::size_t k = 0; k < limits.yaws; ++k) {
    area.score(offsets.data() + 2 * m * k, slices, m, scores[k]);
    for (const Window& window : windows) ++histogram[scores[k][window.place]];
  }
  std::size_t least = 8 * m, better = 0;
  while (least > 0 && better + histogram[least] <= limits.width) better += histogram[least--];
  std::size_t equal = limits.width - better;
  std::vector<Branch> branches;
  for (std::uint32_t k = 0; k < limits.yaws; ++k) {
    for (const Window& window : windows) {
      const std::uint16_t s = scores[k][window.place];
      if (s < least || (s == least && equal == 0)) continue;
      if (s == least) --equal;
      branches.push_back({s, k, window.x * side, window.y * side});
    }
  }
  return branches;
}

// What a query's columns can reach in windows of a level.
class Bounds {
 public:
  Bounds(const SearchArea& area, const float* columns, const std::vector<std::uint8_t>& slices,
         const SearchLimits& limits)
      : area_(area),
        slices_(slices),
        offsets_(turned(columns, slices.size(), area.map().cell(), limits)) {
    if (!area.is_flat(limits.leaf_level)) return;
    steps_.reserve(offsets_.size() / 2);
    for (std::size_t i = 0; i < offsets_.size(); i += 2) {
      steps_.push_back(offsets_[i] + area.wide() * offsets_[i + 1]);
    }
  }

  const std::vector<std::int32_t>& offsets() const { return offsets_; }

  // The most that a pose within a window can reach with columns from `begin` to `end`.
  std::uint32_t one(int level, const Branch& b, std::size_t begin, std::size_t end) const {
    std::uint32_t sum = 0;
    if (steps_.empty()) {
      const std::int32_t* offsets = offsets_.data() + 2 * slices_.size() * b.yaw;
      for (std::size_t i = begin; i < end; ++i) {
        const std::uint8_t found =
            area_.map().at(level, b.x + offsets[2 * i], b.y + offsets[2 * i + 1]);
        sum += kOnes.of[found & slices_[i]];
      }
      return sum;
    }
    const std::uint8_t* here = area_.flat(level, b.x, b.y);
    const std::int32_t* steps = steps_.data() + slices_.size() * b.yaw;
    for (std::size_t i = begin; i < end; ++i) sum += kOnes.of[here[steps[i]] & slices_[i]];
    return sum;
  }

  // Adds the same to the scores of the four quarters of one window.
  void four(int level, Branch* quarters, std::size_t begin, std::size_t end) const {
    if (steps_.empty()) {
      for (int k = 0; k < 4; ++k) quarters[k].score += one(level, quarters[k], begin, end);
      return;
    }
    const std::uint8_t* here[4];
    for (int k = 0; k < 4; ++k) here[k] = area_.flat(level, quarters[k].x, quarters[k].y);
    const std::int32_t* steps = steps_.data() + slices_.size() * quarters[0].yaw;
    std::uint32_t sums[4] = {0, 0, 0, 0};
    for (std::size_t i = begin; i < end; ++i) {
      SEGLOC_UNROLL
      for (int k = 0; k < 4; ++k) sums[k] += kOnes.of[here[k][steps[i]] & slices_[i]];
    }
    for (int k = 0; k < 4; ++k) quarters[k].score += sums[k];
  }

 private:
  const SearchArea& area_;
  const std::vector<std::uint8_t>& slices_;
  std::vector<std::int32_t> offsets_, steps_;  // in cells, and in bytes of a flat level
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

// The four quarters of each window, without scores.
std::vector<Branch> divided(const std::vector<Branch>& branches, int level) {
  std::vector<Branch> parts;
  parts.reserve(4 * branches.size());
  const std::int32_t half = 1 << level;
  for (const Branch& b : branches) {
    for (const std::int32_t y : {b.y, b.y + half}) {
      for (const std::int32_t x : {b.x, b.x + half}) parts.push_back({0, b.yaw, x, y});
    }
  }
  return parts;
}

// The columns in an order whose beginning, of the size that is returned, is spread over all.
std::size_t spread(const float* columns, const std::uint8_t* slices, std::size_t m,
                   std::vector<float>& ordered, std::vector<std::uint8_t>& of_ordered) {
  std::size_t next = 0, first = 0;
  for (const bool chosen : {true, false}) {
    for (std::size_t i = 0; i < m; ++i) {
      if ((i % kOneOf == 0) != chosen) continue;
      std::copy_n(columns + 2 * i, 2, &ordered[2 * next]);
      of_ordered[next++] = slices[i];
    }
    if (chosen) first = next;
  }
  return first;
}

bool alike(const PlanarPose& a, const PlanarPose& b, const SearchLimits& limits) {
  if (!(std::hypot(a.x - b.x, a.y - b.y) < limits.separation)) return false;
  return std::abs(std::remainder(a.yaw - b.yaw, 2.0 * kPi)) * 180.0 / kPi < limits.separation_deg;
}

// A leaf's pose, to a fraction of its window: the mean of the windows and headings about it, begun
// a cell and turned a step apart, that hold the most.
PlanarPose centred(const Branch& leaf, const Bounds& bounds, std::size_t m, double cell,
                   const SearchLimits& limits) {
  std::uint32_t most = 0;
  double ties = 0, x = 0, y = 0, turn = 0;
  for (int step = 0; step < 27; ++step) {
    const int dx = step % 3 - 1, dy = step / 3 % 3 - 1, dk = step / 9 - 1;
    const int yaw = (int(leaf.yaw) + dk + int(limits.yaws)) % int(limits.yaws);
    const Branch other{0, static_cast<std::uint32_t>(yaw), leaf.x + dx, leaf.y + dy};
    const std::uint32_t score = bounds.one(limits.leaf_level, other, 0, m);
    if (score < most) continue;
    if (score > most) most = score, ties = x = y = turn = 0;
    ++ties, x += dx, y += dy, turn += dk;
  }
  // A column falls half a cell, on average, past the cell that it begins in.
  const double middle = 0.5 * (double(1 << limits.leaf_level) - 1.0);
  return {(leaf.x + x / ties + middle) * cell, (leaf.y + y / ties + middle) * cell,
          angle(leaf.yaw, limits) + turn / ties * angle(1, limits), leaf.score};
}

std::vector<PlanarPose> apart(std::vector<Branch>& branches, const Bounds& bounds, std::size_t m,
                              double cell, const SearchLimits& limits) {
  std::sort(branches.begin(), branches.end());
  std::vector<PlanarPose> poses;
  std::vector<Branch> chosen;
  const double middle = 0.5 * double(1 << limits.leaf_level);
  for (const Branch& b : branches) {
    if (poses.size() == limits.count) break;
    const PlanarPose pose{(b.x + middle) * cell, (b.y + middle) * cell, angle(b.yaw, limits),
                          b.score};
    if (std::hypot(pose.x - limits.x, pose.y - limits.y) > limits.radius) continue;
    const auto known = [&](const PlanarPose& other) { return alike(pose, other, limits); };
    if (std::any_of(poses.begin(), poses.end(), known)) continue;
    poses.push_back(pose);
    chosen.push_back(b);
  }
  for (std::size_t i = 0; i < poses.size(); ++i) {
    poses[i] = centred(chosen[i], bounds, m, cell, limits);
  }
  return poses;
}

}  // namespace

std::vector<PlanarPose> SearchArea::search(const float* columns, const std::uint8_t* slices,
                                           std::size_t m, const SearchLimits& limits) const {
  std::vector<float> ordered(2 * m);
  std::vector<std::uint8_t> of_ordered(m);
  const std::size_t first = spread(columns, slices, m, ordered, of_ordered);
  const Bounds bounds(*this, ordered.data(), of_ordered, limits);
  std::vector<Branch> branches =
      best_windows(*this, bounds.offsets(), of_ordered.data(), m, limits);
  for (int level = map_.levels() - 2; level >= limits.leaf_level; --level) {
    keep_best(branches, limits.width);
    by_place(branches);
    std::vector<Branch> parts = divided(branches, level);
    for (std::size_t k = 0; k < parts.size(); k += 4) bounds.four(level, &parts[k], 0, first);
    const bool last = level == limits.leaf_level;
    keep_best(parts, last ? std::max(limits.width / kLastOf, kOfPoses * limits.count)
                          : kOfParts * limits.width);
    by_place(parts);
    for (Branch& part : parts) part.score += bounds.one(level, part, first, m);
    branches = std::move(parts);
  }
  return apart(branches, bounds, m, map_.cell(), limits);
}

}  // namespace segloc
