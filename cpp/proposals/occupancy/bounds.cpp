#include "proposals/occupancy/bounds.h"

#include <algorithm>
#include <cmath>

#include "common/angles.h"
#include "common/portability.h"

namespace segloc {
namespace {

// Every how many columns is scored first, and how many free cells. Fewer free cells than
// `kFewestFree` count as that number.
constexpr std::size_t kOneOf = 4, kSomeFree = 64, kFewestFree = 64;
// The widest windows are scored by no fewer columns, a multiple of those scored first.
constexpr std::size_t kFewestWide = 128;

// Cost of all free cells being blocked, relative to the largest possible score. Set by hand.
constexpr float kCost = 2.0f;

// The bits of each byte.
struct BitCounts {
  std::uint8_t of[256] = {};
  constexpr BitCounts() {
    for (int v = 1; v < 256; ++v) of[v] = static_cast<std::uint8_t>((v & 1) + of[v / 2]);
  }
};
constexpr BitCounts kOnes;

std::size_t ones(const std::uint8_t* slices, std::size_t n) {
  std::size_t sum = 0;
  for (std::size_t i = 0; i < n; ++i) sum += kOnes.of[slices[i]];
  return sum;
}

// The rows that are `every` apart, from the first on, then those from the second on, and so forth:
// the beginning is spread over all.
template <typename T>
std::vector<T> spread(const T* rows, std::size_t n, std::size_t wide, std::size_t every) {
  std::vector<T> ordered;
  ordered.reserve(n * wide);
  for (std::size_t begin = 0; begin < std::min(n, every); ++begin) {
    for (std::size_t i = begin; i < n; i += every) {
      ordered.insert(ordered.end(), rows + wide * i, rows + wide * (i + 1));
    }
  }
  return ordered;
}

// How many of m columns, so ordered, the widest windows are scored by.
std::size_t wide_of(std::size_t m) {
  const std::size_t round = std::max<std::size_t>(1, (m + kOneOf - 1) / kOneOf);
  return std::min(m, (kFewestWide + round - 1) / round * round);
}

std::vector<float> some_of(std::vector<float> places, std::size_t count) {
  places.resize(2 * count);
  return places;
}

// At most `most` free cells that are clear to the edges of a level's windows.
std::vector<float> free_of(const PlanarView& view, int level, std::size_t most) {
  const int reach = std::max(2, (1 << level) / 2);
  const auto* end = std::find_if(view.clearance, view.clearance + view.f,
                                 [&](std::uint8_t clear) { return clear < reach; });
  const auto n = static_cast<std::size_t>(end - view.clearance), count = std::min(n, most);
  std::vector<float> chosen;
  for (std::size_t k = 0; k < count; ++k) {
    const float* place = view.free + 2 * (k * n / count);
    chosen.insert(chosen.end(), place, place + 2);
  }
  return chosen;
}

}  // namespace

double angle(double k, const SearchLimits& limits) {
  return 2.0 * kPi * k / double(limits.yaws);
}

Steps::Steps(const SearchArea& area, const std::vector<float>& places, const SearchLimits& limits,
             std::size_t turned)
    : size_(places.size() / 2), offsets_(places.size() * turns(limits, turned)) {
  auto* next = offsets_.data();
  for (std::size_t k = 0; k < limits.yaws; k += turned) {
    const std::size_t last = std::min(k + turned, limits.yaws) - 1;
    const double middle = angle(0.5 * double(k + last), limits);
    const double c = std::cos(middle), s = std::sin(middle);
    for (std::size_t i = 0; i < places.size(); i += 2) {
      const double x = places[i], y = places[i + 1];
      *next++ = static_cast<std::int32_t>(std::floor((c * x - s * y) / area.map().cell()));
      *next++ = static_cast<std::int32_t>(std::floor((s * x + c * y) / area.map().cell()));
    }
  }
  if (!area.is_flat()) return;
  steps_.reserve(offsets_.size() / 2);
  for (std::size_t i = 0; i < offsets_.size(); i += 2) {
    steps_.push_back(offsets_[i] + area.wide() * offsets_[i + 1]);
  }
}

Bounds::Bounds(const SearchArea& area, const PlanarView& view, const SearchLimits& limits)
    : area_(area),
      leaf_level_(limits.leaf_level),
      slices_(spread(view.slices, view.m, 1, kOneOf)),
      first_((view.m + kOneOf - 1) / kOneOf),
      wide_(wide_of(view.m)),
      most_(ones(slices_.data(), view.m)),
      most_first_(ones(slices_.data(), first_)),
      most_wide_(ones(slices_.data(), wide_)),
      columns_(area, spread(view.columns, view.m, 2, kOneOf), limits),
      turned_(area, some_of(spread(view.columns, view.m, 2, kOneOf), wide_), limits, kTurned),
      all_free_(area, free_of(view, limits.leaf_level, view.f), limits) {
  const int top = area.map().levels() - 1;
  for (int level = 0; level <= top; ++level) {
    const std::vector<float> places = free_of(view, level, kSomeFree);
    free_.emplace_back(area, places, limits, level == top ? kTurned : 1);
  }
}

void Bounds::all(const std::vector<std::size_t>& runs, std::size_t turn,
                 std::vector<std::uint16_t>& held, std::vector<std::uint16_t>& scores) const {
  area_.score(runs, turned_.offsets(turn), slices_.data(), wide_, held);
  const Steps& free = free_.back();
  area_.blocked(runs, free.offsets(turn), free.size(), scores);
  const float each = float(most_wide_) * kCost / float(std::max(free.size(), kFewestFree));
  for (std::size_t i = 0; i < scores.size(); ++i) {
    const float left = float(held[i]) - each * float(scores[i]);
    scores[i] = static_cast<std::uint16_t>(std::max(0.0f, left));
  }
}

void Bounds::roughly(int level, Branch* quarters, bool costly) const {
  four(level, quarters, first_);
  const Steps& free = free_[static_cast<std::size_t>(level)];
  for (int k = 0; k < 4; ++k) {
    Branch& b = quarters[k];
    b.score = float(b.held);
    if (costly) b.score -= float(most_first_) * cost(level, b, free);
  }
}

void Bounds::finish(int level, Branch& branch, bool costly) const {
  branch.held += one(level, branch, first_, slices_.size());
  branch.score = costly ? score(level, branch) : float(branch.held);
}

float Bounds::score(int level, const Branch& b) const {
  const Steps& free = level == leaf_level_ ? all_free_ : free_[static_cast<std::size_t>(level)];
  return float(b.held) - float(most_) * cost(level, b, free);
}

std::uint32_t Bounds::one(int level, const Branch& b, std::size_t begin, std::size_t end) const {
  std::uint32_t sum = 0;
  if (!area_.is_flat() || level == 0) {
    const std::int32_t* offsets = columns_.offsets(b.yaw);
    for (std::size_t i = begin; i < end; ++i) {
      const std::uint8_t found =
          area_.map().at(level, b.x + offsets[2 * i], b.y + offsets[2 * i + 1]);
      sum += kOnes.of[found & slices_[i]];
    }
    return sum;
  }
  const std::uint8_t* here = area_.flat(level, b.x, b.y);
  const std::int32_t* steps = columns_.flat(b.yaw);
  for (std::size_t i = begin; i < end; ++i) sum += kOnes.of[here[steps[i]] & slices_[i]];
  return sum;
}

void Bounds::four(int level, Branch* quarters, std::size_t end) const {
  if (!area_.is_flat() || level == 0) {
    for (int k = 0; k < 4; ++k) quarters[k].held = one(level, quarters[k], 0, end);
    return;
  }
  const std::uint8_t* here[4];
  for (int k = 0; k < 4; ++k) here[k] = area_.flat(level, quarters[k].x, quarters[k].y);
  const std::int32_t* steps = columns_.flat(quarters[0].yaw);
  std::uint32_t sums[4] = {0, 0, 0, 0};
  for (std::size_t i = 0; i < end; ++i) {
    SEGLOC_UNROLL
    for (int k = 0; k < 4; ++k) sums[k] += kOnes.of[here[k][steps[i]] & slices_[i]];
  }
  for (int k = 0; k < 4; ++k) quarters[k].held = sums[k];
}

float Bounds::cost(int level, const Branch& b, const Steps& free) const {
  const std::int32_t middle = (std::int32_t{1} << level) / 2, x = b.x + middle, y = b.y + middle;
  std::uint32_t sum = 0;
  if (area_.is_flat()) {
    const std::uint8_t* here = area_.flat(0, x, y);
    const std::int32_t* steps = free.flat(b.yaw);
    for (std::size_t i = 0; i < free.size(); ++i) sum += here[steps[i]];
  } else {
    const std::int32_t* offsets = free.offsets(b.yaw);
    for (std::size_t i = 0; i < free.size(); ++i) {
      sum += area_.is_blocked(x + offsets[2 * i], y + offsets[2 * i + 1]);
    }
  }
  return kCost * float(sum) / float(std::max(free.size(), kFewestFree));
}

}  // namespace segloc
