// The occupancy search, at every size from nothing up.
#include "occupancy/occupancy_pyramid.h"
#include "occupancy/pose_search.h"
#include "tests/check.h"

namespace segloc {
namespace {

// What stands in a map about a place is found there.
void finds_what_it_was_made_of() {
  const std::vector<std::int32_t> roots = {-1, -1, 0, -1, -1, 0, 0, 0, 1, 0};
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
    const auto poses = area.search(columns.data(), slices.data(), n, limits);
    CHECK(poses.size() <= limits.count);
    for (const PlanarPose& pose : poses) {
      digest("pose_search", std::vector<double>{pose.yaw, pose.x, pose.y});
    }
    for (const PlanarPose& pose : poses) CHECK(pose.score <= n);
    if (n < 17 || n > 300) continue;  // one place only explains all columns, or all do
    CHECK(poses[0].score >= n - n / 8 && std::fabs(poses[0].yaw) < 1e-9);
    CHECK(std::fabs(poses[0].x - 1.0) <= 1.0 && std::fabs(poses[0].y - 2.0) <= 1.0);
  }
}

// The plain images say of every cell about the roots what the pyramid does.
void lays_out_the_levels() {
  const auto points = random_floats(900, -12.0f, 12.0f, 10);
  const std::vector<std::uint8_t> slices(300, 5);
  const OccupancyPyramid pyramid(points.data(), slices.data(), 300, 0.5, 4);
  const std::int32_t roots[4] = {-2, 0, 3, -1};
  const SearchArea area(pyramid, roots, 2, 20.0);
  CHECK(!area.is_flat(0));
  for (int level = 1; level < 3; ++level) {
    CHECK(area.is_flat(level));
    for (std::int32_t y = -8 - 41; y < 8 + 41; ++y) {
      for (std::int32_t x = -16 - 41; x < 32 + 41; ++x) {
        CHECK(*area.flat(level, x, y) == pyramid.at(level, x, y));
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

}  // namespace
}  // namespace segloc

void occupancy_tests() {
  segloc::finds_what_it_was_made_of();
  segloc::lays_out_the_levels();
  segloc::refuses_what_lies_too_far_apart();
}
