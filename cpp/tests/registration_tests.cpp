// Registration at every size from nothing up.
#include <cmath>

#include "registration/gicp.h"
#include "registration/surface.h"
#include "tests/check.h"

namespace segloc {
namespace {

void registration() {
  for (const std::size_t n : kSizes) {
    auto points = random_floats(3 * n, -8.0f, 8.0f, 7);
    for (std::size_t i = 0; i < n; ++i) points[3 * i + i % 3] = -8.0f;  // three walls
    const Surface surface(points.data(), n, 1.5, 1.6);
    Rigid start;
    start.t = {0.2, -0.1, 0.15};
    const GicpResult one = align(surface, surface, start, {}, 1),
                     two = align(surface, surface, start, {}, 2);
    CHECK(one.T.t == two.T.t && one.T.R == two.T.R && one.H == two.H);
    CHECK(one.inliers <= n && std::isfinite(one.error));
    if (n < 1000) continue;
    for (const double t : one.T.t) CHECK(std::fabs(t) < 0.05);
    start.t = {1e9, 0, 0};
    CHECK(align(surface, surface, start, {}, 2).inliers == 0);
    start.t = {std::nan(""), 0, 0};
    CHECK(align(surface, surface, start, {}, 2).inliers == 0);
  }
}

}  // namespace
}  // namespace segloc

void registration_tests() { segloc::registration(); }
