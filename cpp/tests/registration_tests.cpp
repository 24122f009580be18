// Registration at every size from nothing up.
#include <cmath>

#include "likelihood/gicp.h"
#include "likelihood/surface.h"
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
    digest("gicp", one.T.t);
    digest("gicp", one.H);
    if (n < 1000) continue;
    for (const double t : one.T.t) CHECK(std::fabs(t) < 0.05);
    start.t = {1e9, 0, 0};
    CHECK(align(surface, surface, start, {}, 2).inliers == 0);
    start.t = {std::nan(""), 0, 0};
    CHECK(align(surface, surface, start, {}, 2).inliers == 0);
  }
}

void points_on_a_plane() {
  for (const std::size_t n : kSizes) {
    auto points = random_floats(3 * n, -8.0f, 8.0f, 8);
    for (std::size_t i = 0; i < n; ++i) points[3 * i + 2] = 0.0f;
    const Surface plane(points.data(), n, 1.5, 1.6);
    Rigid raised;
    raised.t = {0.0, 0.0, 0.25};
    const Slope level{0.9, 2.0}, steep{-1.0, 0.3};
    const OnPlane within = on_plane(plane, plane, raised, 1, level, 0.3);
    CHECK(within.hits == within.of && within.of <= n);
    CHECK(n < 4000 || within.of > n * 9 / 10);
    CHECK(on_plane(plane, plane, raised, 1, level, 0.2).hits == 0);
    CHECK(on_plane(plane, plane, raised, 1, steep, 0.3).of == 0);
    raised.t = {0.0, 0.0, 50.0};
    CHECK(on_plane(plane, plane, raised, 1, level, 0.3).of == 0);
  }
}

}  // namespace
}  // namespace segloc

void registration_tests() {
  segloc::registration();
  segloc::points_on_a_plane();
}
