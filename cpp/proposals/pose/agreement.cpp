#include "proposals/pose/agreement.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <utility>

namespace segloc {
namespace {

constexpr std::size_t kStrips = 1024;
constexpr double kInfinite = std::numeric_limits<double>::infinity();

}  // namespace

Agreement::Agreement(std::vector<Match> matches, std::size_t objects, const Tolerance& tolerance)
    : matches_(matches.size()), starts_(kStrips + 1), objects_(objects), tolerance_(tolerance) {
  double high = -kInfinite;
  low_ = kInfinite;
  for (const Match& m : matches) {
    reach_ = std::max(reach_, std::hypot(m.from[0], m.from[1], m.from[2]));
    low_ = std::min(low_, m.to[0]);
    high = std::max(high, m.to[0]);
  }
  reach_ = 1.001 * reach_ + tolerance.across;
  if (high > low_) strips_per_metre_ = kStrips / (high - low_);
  for (const Match& m : matches) ++starts_[strip_of(m.to[0])];
  std::size_t before = 0;
  for (std::size_t& start : starts_) before += std::exchange(start, before);
  std::vector<std::size_t> next = starts_;
  for (const Match& m : matches) matches_[next[strip_of(m.to[0])]++] = m;
}

std::size_t Agreement::strip_of(double x) const {
  const double strip = (x - low_) * strips_per_metre_;
  return strip > 0.0 ? static_cast<std::size_t>(std::min(strip, kStrips - 1.0)) : 0;
}

std::size_t Agreement::count(const Rigid& T) const {
  const double nearest = tolerance_.across * tolerance_.across;
  std::vector<bool> agrees(objects_);
  std::size_t count = 0;
  auto match = matches_.begin() + std::ptrdiff_t(starts_[strip_of(T.t[0] - reach_)]);
  const auto end = matches_.begin() + std::ptrdiff_t(starts_[strip_of(T.t[0] + reach_) + 1]);
  for (; match != end; ++match) {
    if (agrees[match->object]) continue;
    const auto moved = T.apply(match->from);
    const double dx = match->to[0] - moved[0], dy = match->to[1] - moved[1];
    if (!(dx * dx + dy * dy < nearest)) continue;
    if (!(std::abs(match->to[2] - moved[2]) < tolerance_.height)) continue;
    agrees[match->object] = true;
    ++count;
  }
  return count;
}

}  // namespace segloc
