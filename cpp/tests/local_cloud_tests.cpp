// The window of scans at every size from nothing up: what comes and goes leaves no trace.

#include <cmath>
#include <utility>

#include "frontend/voxel_table.h"
#include "frontend/voxel_window.h"
#include "tests/check.h"

namespace segloc {
namespace {

constexpr double kVoxel = 0.2, kReach = 60.0, kRadius = 20.0;

Rigid pose(double yaw, double x, double y = 0.0, double z = 0.0) {
  Rigid T;
  T.R = {std::cos(yaw), -std::sin(yaw), 0, std::sin(yaw), std::cos(yaw), 0, 0, 0, 1};
  T.t = {x, y, z};
  return T;
}

void tables() {
  VoxelTable table(8), fresh(8);
  VoxelRuns runs, odd;
  for (std::int64_t k = 0; k < 3000; ++k) {
    const auto at = [&](std::int64_t step) { return Fixed{k * step % 997 - 400} * kOne + k; };
    (k % 2 ? odd : runs).append(at(3), at(7), at(11));
  }
  runs.add_to(table);
  odd.add_to(table);
  odd.remove_from(table);
  runs.add_to(fresh);
  CHECK(table.size() == fresh.size() && table.size() > 0);
  std::size_t same = 0;
  table.visit([&](std::uint64_t key, const VoxelSum& sum) {
    fresh.visit([&](std::uint64_t other, const VoxelSum& mean) {
      same += key == other && sum.count == mean.count && sum.x == mean.x && sum.z == mean.z;
    });
  });
  CHECK(same == table.size());
  runs.remove_from(table);
  CHECK(table.size() == 0);
  const std::array<Fixed, 3> cell = {-5, 3, (Fixed{1} << 30) + 7};
  CHECK(cell_near(voxel_key(cell[0] * kOne, cell[1] * kOne, cell[2] * kOne),
                  {100, -900, Fixed{1} << 30}) == cell);
}

void windows() {
  for (const std::size_t n : kSizes) {
    VoxelWindow window(kVoxel, kReach), fresh(kVoxel, kReach);
    CHECK(window.cloud({}, kRadius).empty());
    std::vector<Rigid> moved;
    for (unsigned k = 0; k < 6; ++k) {
      const auto points = random_floats(3 * n, -30.0f, 30.0f, k);
      window.push(points.data(), n, pose(0.3 * k, 4.5e5 + k, 5.4e6));
      if (k < 2) continue;
      moved.push_back(pose(0.3 * k, -0.1 * k, 0.2));
      fresh.push(points.data(), n, moved.back());
    }
    window.drop(0);
    window.drop(0);
    window.move(moved);
    const auto cloud = window.cloud(pose(0.1, 0.0), kRadius);
    CHECK(cloud == fresh.cloud(pose(0.1, 0.0), kRadius));
    CHECK(cloud.size() % 3 == 0 && all_finite(cloud) && window.voxels() == fresh.voxels());
    CHECK((n > 0 || cloud.empty()) && window.nbytes() > 0);
    while (window.scans() > 0) window.drop(window.scans() / 2);
    CHECK(window.voxels() == 0);
  }
}

void refused() {
  const std::vector<float> same(3000, 2.0f);
  VoxelWindow window(kVoxel, kReach);
  window.push(same.data(), 1000, {});
  CHECK(window.voxels() == 1);
  CHECK_THROWS(window.push(same.data(), 1000, pose(0, 1e6)));
  CHECK_THROWS(window.push(same.data(), 1000, pose(0, 1e15)));
  CHECK_THROWS(window.move({pose(0, 1e15)}));
  CHECK_THROWS(window.move({}));
  CHECK_THROWS(window.drop(1));
  CHECK(window.scans() == 1 && window.cloud({}, 1.0).empty());
  CHECK_THROWS(VoxelWindow(0.0, 1.0));
  CHECK_THROWS(VoxelWindow(1e-6, 10.0));
}

}  // namespace
}  // namespace segloc

void local_cloud_tests() {
  segloc::tables();
  segloc::windows();
  segloc::refused();
}
