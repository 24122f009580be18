// The occupancy search, at every size from nothing up.
#include "common/angles.h"
#include "proposals/occupancy/occupancy_pyramid.h"
#include "proposals/occupancy/polar_images.h"
#include "proposals/occupancy/pose_search.h"
#include "tests/check.h"

namespace segloc {
namespace {

// What stands in a map about a place is found there.
void finds_what_it_was_made_of() {
  const std::vector<std::int32_t> roots = {-1, -1, 0, -1, -1, 0, 0, 0, 1, 0};
  const auto free = random_floats(40, -12.0f, 12.0f, 11);
  std::vector<std::uint8_t> clearance;
  for (int i = 0; i < 20; ++i) clearance.push_back(static_cast<std::uint8_t>(5 - i / 5));
  for (const std::size_t n : kSizes) {
    auto points = random_floats(3 * n, -12.0f, 12.0f, 9);
    std::vector<std::uint8_t> slices(n);
    std::vector<float> columns;
    for (std::size_t i = 0; i < n; ++i) {
      slices[i] = static_cast<std::uint8_t>(1u << (i % 8));
      columns.push_back(points[3 * i] - 1.0f);
      columns.push_back(points[3 * i + 1] - 2.0f);
    }
    const OccupancyPyramid pyramid(points.data(), slices.data(), n, 0.5, 4);
    const SearchArea area(pyramid, roots.data(), roots.size() / 2, 20.0);
    SearchLimits limits;
    limits.yaws = 24;
    limits.count = 3;
    const PlanarView view{columns.data(), slices.data(),    n,
                          free.data(),    clearance.data(), clearance.size()};
    const auto poses = area.search(view, limits);
    CHECK(poses.size() <= limits.count);
    for (const PlanarPose& pose : poses) {
      digest("pose_search", std::vector<double>{pose.yaw, pose.x, pose.y});
    }
    for (const PlanarPose& pose : poses) CHECK(pose.score <= float(n));
    if (n < 17 || n > 300) continue;  // one place only explains all columns, or all do
    CHECK(poses[0].score >= float(n - n / 8) && std::fabs(poses[0].yaw) < 1e-9);
    CHECK(std::fabs(poses[0].x - 1.0) <= 1.0 && std::fabs(poses[0].y - 2.0) <= 1.0);
  }
}

// The plain images say of every cell about the roots what the pyramid does.
void lays_out_the_levels() {
  const auto points = random_floats(900, -12.0f, 12.0f, 10);
  std::vector<std::uint8_t> slices(300, 5);
  for (std::size_t i = 0; i < slices.size(); i += 2) slices[i] = 13;  // these block
  const OccupancyPyramid pyramid(points.data(), slices.data(), 300, 0.5, 4);
  const std::int32_t roots[4] = {-2, 0, 3, -1};
  const SearchArea area(pyramid, roots, 2, 20.0);
  CHECK(area.is_flat());
  for (int level = 0; level < 3; ++level) {
    for (std::int32_t y = -8 - 41; y < 8 + 41; ++y) {
      for (std::int32_t x = -16 - 41; x < 32 + 41; ++x) {
        const bool blocked = (pyramid.at(0, x, y) & 15) == 13;
        CHECK(area.is_blocked(x, y) == blocked);
        CHECK(*area.flat(level, x, y) == (level == 0 ? blocked : pyramid.at(level, x, y)));
      }
    }
  }
}

void refuses_what_lies_too_far_apart() {
  const float point[3] = {0, 0, 1};
  const std::uint8_t slice = 1;
  const OccupancyPyramid pyramid(point, &slice, 1, 0.5, 4);
  const std::int32_t roots[4] = {0, 0, 1 << 20, 1 << 20};
  CHECK_THROWS(SearchArea(pyramid, roots, 2, 20.0));
}

// Each cell lies in one direction and ring of an image, or beyond it, whatever the others are.
void sees_each_cell_once() {
  const PolarGrid grid{1.5, 4, 2, 16};
  const std::vector<float> places = {0.0f, 0.0f, 3.0f, -2.0f};
  const auto cells = random_floats(2 * 300, -9.0f, 9.0f, 12);
  const std::vector<std::uint8_t> slices(300, 0x21);  // one in each band
  std::vector<std::uint8_t> all(2 * 4 * 2 * 16);
  for (std::size_t i = 0; i < slices.size(); ++i) {
    const auto one = polar_images(&cells[2 * i], &slices[i], 1, places.data(), 2, grid, 1);
    for (std::size_t k = 0; k < 2; ++k) {
      const double dx = cells[2 * i] - places[2 * k], dy = cells[2 * i + 1] - places[2 * k + 1];
      const double ring = std::hypot(dx, dy) / 1.5;
      const double turn = std::atan2(dy, dx) / (2 * kPi);
      const int sector = static_cast<int>(std::floor(16 * turn) + 16) % 16;
      int seen = 0;
      for (std::size_t j = 0; j < 128; ++j) seen += one[128 * k + j];
      CHECK(seen == (ring < 4 ? 2 : 0));
      if (ring < 4) {
        CHECK(one[128 * k + 32 * static_cast<std::size_t>(ring) + static_cast<std::size_t>(sector)]);
      }
    }
    for (std::size_t j = 0; j < all.size(); ++j) all[j] |= one[j];
  }
  const auto together =
      polar_images(cells.data(), slices.data(), slices.size(), places.data(), 2, grid, 2);
  CHECK(together == all);
  digest("polar_images", together);
}

}  // namespace
}  // namespace segloc

void occupancy_tests() {
  segloc::finds_what_it_was_made_of();
  segloc::lays_out_the_levels();
  segloc::refuses_what_lies_too_far_apart();
  segloc::sees_each_cell_once();
}
