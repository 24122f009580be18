// Verification at every size from nothing up.
#include <cstdint>

#include "tests/check.h"
#include "verification/point_index.h"
#include "verification/visibility.h"

namespace segloc {
namespace {

void point_index() {
  for (const std::size_t n : kSizes) {
    const auto points = random_floats(3 * n, -20.0f, 20.0f, 1);
    const PointIndex index(points.data(), n, 0.5);
    const double identity[16] = {1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1};
    CHECK(index.overlap(points.data(), n, identity, 0.5).near == n);
    CHECK(index.sample(0, 0, 1000, n + 1).size() == 3 * n && index.sample(500, 0, 1, 9).empty());
    const double away[16] = {1, 0, 0, 1e9, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1};
    CHECK(index.overlap(points.data(), n, away, 0.5).near == 0);
  }
}

void visibility() {
  for (const std::size_t n : kSizes) {
    auto ground = random_floats(3 * n, -20.0f, 20.0f, 2);
    for (std::size_t i = 0; i < n; ++i) ground[3 * i + 2] = -2.0f;
    const auto points = random_floats(3 * n, -20.0f, 20.0f, 1);
    const VisibilityCheck check(points.data(), n, ground.data(), n, 50.0, 1.0, 0.5);
    const double identity[16] = {1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1};
    const auto own = check.count(points.data(), n, identity, 0.5, 0.5);
    CHECK(own.violations == 0 && own.confirmed <= std::int64_t(n));
    CHECK(n < 4000 || own.confirmed > std::int64_t(n) / 4);
    const double away[16] = {1, 0, 0, 1e9, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1};
    const auto none = check.count(points.data(), n, away, 0.5, 0.5);
    CHECK(none.confirmed == 0 && none.violations == 0);
  }
}

}  // namespace
}  // namespace segloc

void verification_tests() {
  segloc::point_index();
  segloc::visibility();
}
