#include "occupancy/pose_search.h"

#include <algorithm>
#include <cmath>
#include <stdexcept>
#include <tuple>
#include <utility>

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

constexpr std::size_t kMostCells = std::size_t{1} << 26;

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

// The best of all windows at all headings.
std::vector<Branch> best_windows(const SearchArea& area, const std::vector<std::int32_t>& offsets,
                                 const std::uint8_t* slices, std::size_t m,
                                 const SearchLimits& limits) {
  std::vector<std::vector<std::uint16_t>> scores(limits.yaws);
  std::vector<std::size_t> histogram(8 * m + 1, 0);
  const std::int32_t side = 1 << (area.map().levels() - 1);
  const auto near = [&](std::int32_t x, std::int32_t y) {
    return meets(limits, area.map().cell(), x * side, y * side, side);
  };
  for (std::size_t k = 0; k < limits.yaws; ++k) {
    area.score(offsets.data() + 2 * m * k, slices, m, scores[k]);
    area.visit([&](std::size_t i, std::int32_t x, std::int32_t y) {
      if (near(x, y)) ++histogram[scores[k][i]];
    });
  }
  std::size_t least = 8 * m, better = 0;
  while (least > 0 && better + histogram[least] <= limits.width) better += histogram[least--];
  std::size_t equal = limits.width - better;
  std::vector<Branch> branches;
  for (std::uint32_t k = 0; k < limits.yaws; ++k) {
    area.visit([&](std::size_t i, std::int32_t x, std::int32_t y) {
      const std::uint16_t s = scores[k][i];
      if (s < least || (s == least && equal == 0) || !near(x, y)) return;
      if (s == least) --equal;
      branches.push_back({s, k, x * side, y * side});
    });
  }
  return branches;
}

// The most that a pose within a window can reach with some of the columns.
std::uint32_t bound(const OccupancyPyramid& map, int level, const Branch& b,
                    const std::int32_t* offsets, const std::uint8_t* slices, std::size_t begin,
                    std::size_t end) {
  std::uint32_t sum = 0;
  for (std::size_t i = begin; i < end; ++i) {
    const std::uint8_t found = map.at(level, b.x + offsets[2 * i], b.y + offsets[2 * i + 1]);
    sum += kOnes.of[found & slices[i]];
  }
  return sum;
}

void keep_best(std::vector<Branch>& branches, std::size_t width) {
  if (branches.size() <= width) return;
  std::nth_element(branches.begin(), branches.begin() + static_cast<std::ptrdiff_t>(width),
                   branches.end());
  branches.resize(width);
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
  const double turn = std::abs(std::remainder(a.yaw - b.yaw, 2.0 * kPi));
  return std::hypot(a.x - b.x, a.y - b.y) < limits.separation &&
         turn * 180.0 / kPi < limits.separation_deg;
}

// A leaf's pose, to a fraction of its window: the mean of the windows and headings about it, begun
// a cell and turned a step apart, that hold the most.
PlanarPose centred(const Branch& leaf, const OccupancyPyramid& map,
                   const std::vector<std::int32_t>& offsets,
                   const std::vector<std::uint8_t>& slices, const SearchLimits& limits) {
  const std::size_t m = slices.size();
  std::uint32_t most = 0;
  double ties = 0, x = 0, y = 0, turn = 0;
  for (int step = 0; step < 27; ++step) {
    const int dx = step % 3 - 1, dy = step / 3 % 3 - 1, dk = step / 9 - 1;
    const int yaw = (int(leaf.yaw) + dk + int(limits.yaws)) % int(limits.yaws);
    const Branch other{0, static_cast<std::uint32_t>(yaw), leaf.x + dx, leaf.y + dy};
    const std::uint32_t score = bound(map, limits.leaf_level, other,
                                      offsets.data() + 2 * m * other.yaw, slices.data(), 0, m);
    if (score < most) continue;
    if (score > most) most = score, ties = x = y = turn = 0;
    ++ties, x += dx, y += dy, turn += dk;
  }
  // A column falls half a cell, on average, past the cell that it begins in.
  const double middle = 0.5 * (double(1 << limits.leaf_level) - 1.0);
  return {(leaf.x + x / ties + middle) * map.cell(), (leaf.y + y / ties + middle) * map.cell(),
          angle(leaf.yaw, limits) + turn / ties * angle(1, limits), leaf.score};
}

std::vector<PlanarPose> apart(std::vector<Branch>& branches, const OccupancyPyramid& map,
                              const std::vector<std::int32_t>& offsets,
                              const std::vector<std::uint8_t>& slices, const SearchLimits& limits) {
  std::sort(branches.begin(), branches.end());
  std::vector<PlanarPose> poses;
  std::vector<Branch> chosen;
  const double middle = 0.5 * double(1 << limits.leaf_level);
  for (const Branch& b : branches) {
    if (poses.size() == limits.count) break;
    const PlanarPose pose{(b.x + middle) * map.cell(), (b.y + middle) * map.cell(),
                          angle(b.yaw, limits), b.score};
    if (std::hypot(pose.x - limits.x, pose.y - limits.y) > limits.radius) continue;
    const auto known = [&](const PlanarPose& other) { return alike(pose, other, limits); };
    if (std::any_of(poses.begin(), poses.end(), known)) continue;
    poses.push_back(pose);
    chosen.push_back(b);
  }
  for (std::size_t i = 0; i < poses.size(); ++i) {
    poses[i] = centred(chosen[i], map, offsets, slices, limits);
  }
  return poses;
}

}  // namespace

SearchArea::SearchArea(const OccupancyPyramid& map, const std::int32_t* roots, std::size_t r,
                       double range)
    : map_(map), range_(range) {
  if (r == 0) return;
  std::vector<std::pair<std::int32_t, std::int32_t>> sorted;
  std::int32_t high[2] = {roots[0], roots[1]}, low[2] = {roots[0], roots[1]};
  for (std::size_t i = 0; i < 2 * r; ++i) {
    high[i % 2] = std::max(high[i % 2], roots[i]);
    low[i % 2] = std::min(low[i % 2], roots[i]);
  }
  for (std::size_t i = 0; i < r; ++i) sorted.push_back({roots[2 * i + 1], roots[2 * i]});
  std::sort(sorted.begin(), sorted.end());
  const double side = map.cell() * double(1 << (map.levels() - 1));
  const auto pad = static_cast<std::int32_t>(std::ceil(range / side)) + 1;
  low_x_ = low[0] - pad;
  low_y_ = low[1] - pad;
  wide_ = static_cast<std::size_t>(high[0] + pad + kSpan - low_x_);
  high_ = static_cast<std::size_t>(high[1] + pad + 1 - low_y_);
  const int shift = 2 * (map.levels() - 1);
  if ((wide_ << shift) > kMostCells || (wide_ * high_ << shift) > kMostCells) {
    throw std::invalid_argument("roots lie too far apart");
  }
  lay_out();
  for (const auto& [y, x] : sorted) {
    const bool inside = !runs_.empty() && runs_.back().y == y && x - runs_.back().x < kSpan;
    if (!inside) runs_.push_back({x, y, 0, place_of(x, y)});
    runs_.back().members |= 1u << (x - runs_.back().x);
  }
}

void SearchArea::lay_out() {
  const int top = map_.levels() - 1;
  const std::int32_t side = 1 << top;
  image_.reserve(wide_ * high_ << (2 * top));
  for (std::int32_t py = 0; py < side; ++py) {
    for (std::int32_t px = 0; px < side; ++px) {
      for (std::size_t y = 0; y < high_; ++y) {
        const std::int32_t cell_y = (low_y_ + static_cast<std::int32_t>(y)) * side + py;
        for (std::size_t x = 0; x < wide_; ++x) {
          image_.push_back(
              map_.at(top, (low_x_ + static_cast<std::int32_t>(x)) * side + px, cell_y));
        }
      }
    }
  }
}

void SearchArea::score(const std::int32_t* offsets, const std::uint8_t* slices, std::size_t m,
                       std::vector<std::uint16_t>& scores) const {
  constexpr std::size_t kGroup = 31;  // their sum fits a byte
  const int top = map_.levels() - 1;
  const std::int32_t last = (1 << top) - 1;
  const Kernels& kernel_table = kernels(parse_isa("auto"));
  scores.assign(runs_.size() * kRun, 0);
  std::vector<std::uint8_t> sums(scores.size());
  std::vector<std::size_t> places(runs_.size());
  for (std::size_t begin = 0; begin < m; begin += kGroup) {
    std::fill(sums.begin(), sums.end(), std::uint8_t{0});
    for (std::size_t i = begin; i < std::min(m, begin + kGroup); ++i) {
      const std::int32_t x = offsets[2 * i], y = offsets[2 * i + 1];
      const auto place = static_cast<std::size_t>(((y & last) << top) | (x & last));
      const std::ptrdiff_t shift =
          std::ptrdiff_t{y >> top} * static_cast<std::ptrdiff_t>(wide_) + (x >> top);
      const std::size_t first = place * wide_ * high_ + static_cast<std::size_t>(shift);
      for (std::size_t k = 0; k < places.size(); ++k) places[k] = runs_[k].at + first;
      kernel_table.add_slices(image_.data(), places.data(), places.size(), slices[i], sums.data());
    }
    for (std::size_t w = 0; w < sums.size(); ++w) {
      scores[w] = static_cast<std::uint16_t>(scores[w] + sums[w]);
    }
  }
}

std::vector<PlanarPose> SearchArea::search(const float* columns, const std::uint8_t* slices,
                                           std::size_t m, const SearchLimits& limits) const {
  std::vector<float> ordered(2 * m);
  std::vector<std::uint8_t> of_ordered(m);
  const std::size_t first = spread(columns, slices, m, ordered, of_ordered);
  const std::vector<std::int32_t> offsets = turned(ordered.data(), m, map_.cell(), limits);
  std::vector<Branch> branches = best_windows(*this, offsets, of_ordered.data(), m, limits);
  for (int level = map_.levels() - 2; level >= limits.leaf_level; --level) {
    keep_best(branches, limits.width);
    std::vector<Branch> parts = divided(branches, level);
    const auto add = [&](std::size_t begin, std::size_t end) {
      for (Branch& part : parts) {
        const std::int32_t* at = offsets.data() + 2 * m * part.yaw;
        part.score += bound(map_, level, part, at, of_ordered.data(), begin, end);
      }
    };
    add(0, first);
    const bool last = level == limits.leaf_level;
    keep_best(parts, last ? std::max(limits.width / kLastOf, kOfPoses * limits.count)
                          : kOfParts * limits.width);
    add(first, m);
    branches = std::move(parts);
  }
  return apart(branches, map_, offsets, of_ordered, limits);
}

}  // namespace segloc
