// Registration at every size from nothing up.
#include <algorithm>
#include <cmath>
#include <cstdint>
#include <limits>

#include "likelihood/gicp.h"
#include "likelihood/surface.h"
#include "tests/check.h"

namespace segloc {
namespace {

// Every instruction set has the same sums, bit by bit.
void pairs_agree(Isa isa) {
  const Kernels &kernel = kernels(isa), &portable = kernels(Isa::portable);
  const double T[12] = {0.8, -0.6, 0, 0.6, 0.8, 0, 0, 0, 1, 0.1, -0.2, 0.3};
  const double frame[12] = {1, 0, 0, 0, 1, 0, 0, 0, 1, 0, 0, 0};
  for (const std::size_t n : kSizes) {
    const auto places = random_floats(4 * n, -1.0f, 1.0f, 9);
    const auto random = random_floats(13 * n, -1.0f, 1.0f, 10);
    std::vector<double> rows(random.begin(), random.end());
    for (std::size_t i = 0; i < n; ++i) rows[12 * n + i] = i % 3 > 0;
    std::vector<double> weights(6 * n);
    const auto row = [&](std::size_t k) { return rows.data() + k * n; };
    const auto place = [&](std::size_t k) { return places.data() + k * n; };
    const auto weight = [&](std::size_t k) { return weights.data() + k * n; };
    const PairArrays pairs = {
        {row(0), row(1), row(2)}, {row(3), row(4), row(5)}, {row(6), row(7), row(8)},
        {row(9), row(10), row(11)}, row(12), {place(0), place(1), place(2)}, place(3),
        {weight(0), weight(1), weight(2), weight(3), weight(4), weight(5)}};
    const auto results = [&](const Kernels& of) {
      std::vector<double> values(kPairTerms + 1);
      of.sum_pairs(pairs, T, n / 3, n, values.data());
      values[kPairTerms] = of.pair_error(pairs, T, frame, n / 3, n);
      values.insert(values.end(), weights.begin(), weights.end());
      std::vector<float> moved(3 * n);
      std::vector<std::uint8_t> lost(n);
      float* const to[3] = {moved.data(), moved.data() + n, moved.data() + 2 * n};
      of.move_pairs(pairs, T, n / 3, n, to, lost.data());
      values.insert(values.end(), moved.begin(), moved.end());
      values.insert(values.end(), lost.begin(), lost.end());
      return values;
    };
    CHECK(results(kernel) == results(portable));
  }
}

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
    const auto number = [&](const Slope& slope, float least, float most) {
      const auto distances = off_plane(plane, plane, raised, 1, slope);
      CHECK(distances.size() == n);
      return std::size_t(std::count_if(distances.begin(), distances.end(),
                                       [&](float off) { return off >= least && off <= most; }));
    };
    constexpr float kFar = std::numeric_limits<float>::max();
    CHECK(number(level, 0.0f, 0.24f) == 0 && number(level, 0.26f, kFar) == 0);
    CHECK(n < 4000 || number(level, 0.24f, 0.26f) > n * 9 / 10);
    CHECK(number(steep, 0.0f, std::numeric_limits<float>::infinity()) == 0);
    raised.t = {0.0, 0.0, 50.0};
    CHECK(number(level, 0.0f, kFar) == 0);
  }
}

}  // namespace
}  // namespace segloc

void registration_tests() {
  for (const segloc::Isa isa : instruction_sets()) segloc::pairs_agree(isa);
  segloc::registration();
  segloc::points_on_a_plane();
}
