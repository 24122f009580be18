// Verification at every size from nothing up.
#include <algorithm>
#include <cmath>
#include <cstdint>

#include "likelihood/correlation.h"
#include "likelihood/known_space.h"
#include "likelihood/point_index.h"
#include "likelihood/visibility.h"
#include "tests/check.h"

namespace segloc {
namespace {

void point_index() {
  for (const std::size_t n : kSizes) {
    const auto points = random_floats(3 * n, -20.0f, 20.0f, 1);
    const PointIndex index(points.data(), n, 0.5);
    const double identity[16] = {1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1};
    CHECK(index.overlap(points.data(), n, identity, 0.5, n % 2 > 0).near == n);
    CHECK(index.sample({0, 0, 1000}, n + 1).size() == 3 * n);
    CHECK(index.sample({500, 0, 1}, 9).empty());
    const double away[16] = {1, 0, 0, 1e9, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1};
    CHECK(index.overlap(points.data(), n, away, 0.5, true).near == 0);
  }
}

// Every instruction set finds the same pixels, and those of the exact angles.
void pixels_agree(Isa isa) {
  const PixelGrid grid = {2.0, 1e-3, 180, 91};
  auto points = random_floats(3 * 1000, -20.0f, 20.0f, 6);
  for (std::size_t i = 0; i < 300; ++i) points[i] = std::round(points[i] / 10);
  std::vector<std::int32_t> pixels(1000), expected(1000);
  std::vector<float> ranges(1000), expected_ranges(1000);
  kernels(isa).range_pixels(points.data(), 1000, grid, pixels.data(), ranges.data());
  kernels(Isa::portable).range_pixels(points.data(), 1000, grid, expected.data(),
                                      expected_ranges.data());
  CHECK(pixels == expected && ranges == expected_ranges);
  CHECK(std::count(pixels.begin() + 100, pixels.end(), -1) < 50);
  for (std::size_t i = 0; i < 1000; ++i) {
    const double x = points[3 * i], y = points[3 * i + 1], z = points[3 * i + 2];
    const double degrees = 180.0 / std::acos(-1.0), level = std::sqrt(x * x + y * y);
    const int column = int((std::atan2(y, x) * degrees + 180.0) / 2.0) % 180;
    const int row = int((std::atan2(z, level) * degrees + 90.0) / 2.0);
    CHECK(pixels[i] == -1 || pixels[i] == column * 91 + row);
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

void known_space() {
  const double identity[16] = {1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1};
  const double views[6] = {0, 0, 0, 3, -2, 1};
  const auto number = [](const std::vector<std::uint8_t>& codes, Known code) {
    return std::size_t(std::count(codes.begin(), codes.end(), std::uint8_t(code)));
  };
  for (const std::size_t n : kSizes) {
    const auto points = random_floats(3 * n, -20.0f, 20.0f, 4);
    const PointIndex index(points.data(), n, 0.5);
    const KnownSpace known(index, views, 2, {});
    CHECK(number(known.codes(points.data(), n, identity, 0.5), Known::kHit) == n);
    const double away[16] = {1, 0, 0, 1e9, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1};
    CHECK(number(known.codes(points.data(), n, away, 0.5), Known::kUnknown) == n);
    const auto others = random_floats(3 * n, -5.0f, 5.0f, 5);
    const auto two = known.codes(others.data(), n, identity, 0.5);
    const auto one = KnownSpace(index, views, 1, {}).codes(others.data(), n, identity, 0.5);
    const auto none = KnownSpace(index, views, 0, {}).codes(others.data(), n, identity, 0.5);
    CHECK(two.size() == n && two == known.codes(others.data(), n, identity, 0.5));
    CHECK(number(two, Known::kThrough) >= number(one, Known::kThrough));
    CHECK(number(none, Known::kThrough) == 0 && number(none, Known::kMissed) == 0);
  }
}

void correlation() {
  const double here[16] = {1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1};
  const double shifted[16] = {1, 0, 0, 2, 0, 1, 0, -1, 0, 0, 1, 0, 0, 0, 0, 1};
  for (const std::size_t n : kSizes) {
    const auto points = random_floats(3 * n, -20.0f, 4.0f, 3);
    const PointIndex index(points.data(), n, 0.5);
    for (const double half_width : {0.0, 1.0, 3.0, 40.0}) {
      CorrelationOptions options;
      options.half_width = half_width;
      const Correlation found = correlate(index, points.data(), n, here, {0.0, 1.0}, options);
      CHECK(found.counts.size() == 2 * found.width * found.width && found.used.size() == 2);
      const std::size_t middle = found.width / 2 * (found.width + 1);
      CHECK(found.counts[middle] == 4 * found.used[0]);  // every cell lies on itself
      digest("correlation", found.counts);
      for (const std::uint16_t count : found.counts) CHECK(count <= 4 * found.used[0]);
    }
    if (n < 200) continue;
    const Correlation off = correlate(index, points.data(), n, shifted, {0.0}, {});
    const auto best = std::max_element(off.counts.begin(), off.counts.end()) - off.counts.begin();
    const auto width = static_cast<std::ptrdiff_t>(off.width);
    CHECK(best % width == width / 2 - 4 && best / width == width / 2 + 2);
  }
}

}  // namespace
}  // namespace segloc

void verification_tests() {
  segloc::point_index();
  for (const segloc::Isa isa : instruction_sets()) segloc::pixels_agree(isa);
  segloc::visibility();
  segloc::known_space();
  segloc::correlation();
}
