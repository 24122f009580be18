#include "proposals/pose/agreement.h"

#include <algorithm>
#include <cmath>
#include <utility>

namespace segloc {

Agreement::Agreement(std::vector<Match> matches, std::size_t objects, const Tolerance& tolerance)
    : matches_(std::move(matches)), objects_(objects), tolerance_(tolerance) {
  std::stable_sort(matches_.begin(), matches_.end(),
                   [](const Match& a, const Match& b) { return a.to[0] < b.to[0]; });
  for (const Match& m : matches_) {
    reach_ = std::max(reach_, std::hypot(m.from[0], m.from[1], m.from[2]));
  }
  reach_ = 1.001 * reach_ + tolerance.across;
}

std::size_t Agreement::count(const Rigid& T) const {
  const double first = T.t[0] - reach_, last = T.t[0] + reach_;
  const double nearest = tolerance_.across * tolerance_.across;
  std::vector<bool> agrees(objects_);
  std::size_t count = 0;
  auto match = std::lower_bound(matches_.begin(), matches_.end(), first,
                                [](const Match& m, double x) { return m.to[0] < x; });
  for (; match != matches_.end() && match->to[0] <= last; ++match) {
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
