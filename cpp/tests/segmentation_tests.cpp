// Segmentation at every size from nothing up.
#include <algorithm>
#include <cmath>
#include <utility>

#include "common/cells.h"
#include "common/portability.h"
#include "frontend/cluster.h"
#include "frontend/gravity.h"
#include "frontend/ground.h"
#include "frontend/point_grid.h"
#include "tests/check.h"

namespace segloc {
namespace {

constexpr double kAxes[] = {1, 0, 0, 0, 1, 0, 0, 0, 1};

// Every instruction set finds the same cells, the same neighbours and the same order.
void kernels_agree(Isa isa) {
  const Kernels &k = kernels(isa), &portable = kernels(Isa::portable);
  for (const std::size_t n : kSizes) {
    const auto values = random_floats(3 * n + 15, -9.0f, 9.0f, 21);
    std::vector<std::int32_t> cells(n), expected_cells(n);
    k.cell_numbers(values.data(), n, 0.3, cells.data());
    portable.cell_numbers(values.data(), n, 0.3, expected_cells.data());
    CHECK(cells == expected_cells);
    for (std::size_t i = 0; i < n; ++i) CHECK(cells[i] == std::floor(values[i] / 0.3));
    const PointArrays points = {values.data(), values.data() + n, values.data() + 2 * n};
    const float place[] = {1.0f, -2.0f, 0.5f};
    std::vector<std::uint32_t> near(n + 15), expected_near(n + 15);
    near.resize(k.near_points(points, place, 30.0f, n / 3, n, near.data()));
    expected_near.resize(
        portable.near_points(points, place, 30.0f, n / 3, n, expected_near.data()));
    CHECK(near == expected_near);
  }
  for (const std::size_t count : {1, 2, 8, 128}) {
    auto rows = random_floats(kSortLanes * count, -1.0f, 1.0f, 22);
    const auto before = rows;
    k.sort_lanes(rows.data(), count);
    for (std::size_t lane = 0; lane < kSortLanes; ++lane) {
      std::vector<float> found, expected;
      for (std::size_t i = 0; i < count; ++i) {
        found.push_back(rows[kSortLanes * i + lane]);
        expected.push_back(before[kSortLanes * i + lane]);
      }
      std::sort(expected.begin(), expected.end());
      CHECK(found == expected);
    }
  }
}

// Their answers are the same, bit by bit, also where rows end within a vector.
void grounds_agree(Isa isa) {
  const Kernels &k = kernels(isa), &portable = kernels(Isa::portable);
  constexpr int kReach = 3, kColumns = 37, kRows = 11, kStride = kColumns + 20;
  auto z = random_floats(kStride * (kRows + 8), -1.0f, 1.0f, 23);
  for (std::size_t i = 0; i < z.size(); i += 5) z[i] = kInfinity;
  const auto bands = random_floats(49, 0.1f, 0.9f, 24);
  std::vector<std::int32_t> level(kColumns + 15), expected_level(level);
  const float* row = z.data() + 5 * kStride + kReach;
  const float* band = bands.data() + 24;
  k.count_like(row, kStride, kColumns, band, 7, kReach, level.data());
  portable.count_like(row, kStride, kColumns, band, 7, kReach, expected_level.data());
  CHECK(std::equal(level.begin(), level.begin() + kColumns, expected_level.begin()));
  for (float& each : z) each = std::isfinite(each) ? each : 0.5f;
  for (const double edge : {0.5, 0.7}) {
    const GroundLattice lattice = {-4.0, -2.0, edge, edge == 0.5, kColumns, kRows, kStride};
    for (const std::size_t n : kSizes) {
      const auto points = random_floats(3 * n, -5.0f, 8.0f, 25);
      std::vector<std::int32_t> cells(n), expected_cells(n);
      k.ground_cells(points.data(), n, lattice, cells.data());
      portable.ground_cells(points.data(), n, lattice, expected_cells.data());
      CHECK(cells == expected_cells);
      std::vector<float> heights(n), expected(n);
      k.ground_heights(points.data(), n, lattice, z.data(), heights.data());
      portable.ground_heights(points.data(), n, lattice, z.data(), expected.data());
      CHECK(heights == expected);
    }
  }
}

// Checks, extents and votes for the vertical.
void sums_agree(Isa isa) {
  const Kernels &k = kernels(isa), &portable = kernels(Isa::portable);
  constexpr std::size_t kNormals = 48, kDirections = 5;
  const auto normals = random_floats(3 * kNormals, -0.6f, 0.6f, 26);
  const PointArrays arrays = {normals.data(), normals.data() + kNormals,
                              normals.data() + 2 * kNormals};
  const std::vector<double> directions = {0, 0, 1, 0.6, 0, 0.8, 0, 0.6, 0.8, 1, 0, 0, 0, 1, 0};
  std::vector<double> scores(kDirections), expected(kDirections);
  k.agreements(arrays, kNormals, directions.data(), kDirections, 9.0f, scores.data());
  portable.agreements(arrays, kNormals, directions.data(), kDirections, 9.0f, expected.data());
  CHECK(scores == expected);
  auto values = random_floats(3 * kExtentRun, -9.0f, 9.0f, 27);
  std::vector<float> low(kExtentRun), high(kExtentRun);
  k.extent(values.data(), 3, low.data(), high.data());
  for (std::size_t i = 0; i < kExtentRun; ++i) {
    const auto each = {values[i], values[i + kExtentRun], values[i + 2 * kExtentRun]};
    CHECK(low[i] == std::min(each) && high[i] == std::max(each));
  }
  CHECK(k.all_below(values.data(), values.size(), 9.5f));
  for (const float fault : {-9.5f, kInfinity, std::nanf("")}) {
    for (const std::size_t at : {std::size_t{0}, std::size_t{77}, values.size() - 1}) {
      const float kept = std::exchange(values[at], fault);
      CHECK(!k.all_below(values.data(), values.size(), 9.5f));
      values[at] = kept;
    }
  }
}

void clouds() {
  for (const std::size_t n : kSizes) {
    const auto points = random_floats(3 * n, -20.0f, 20.0f, 1);
    const auto voxels = voxel_grid(points.data(), n, 1.5);
    CHECK(voxels.size() % 3 == 0 && voxels.size() <= 3 * n && (n == 0 || !voxels.empty()));
    const auto heights = heights_above_ground(points.data(), n, {});
    CHECK(heights.size() == n);
    digest("voxel_grid", voxels);
    digest("ground", heights);
    CHECK(plane_normals(points.data(), n, {}).size() <= 3 * n);
    const auto normals = flat_normals(points.data(), n, {});
    const auto up = fit_vertical(normals.data(), normals.size() / 3, kAxes, 3, {0.1, 0.05});
    CHECK(std::abs(std::hypot(up[0], up[1], up[2]) - 1.0) < 1e-9);
    std::vector<float> above, below;
    split_by_height(points.data(), heights.data(), n, 1.0, above, below);
    CHECK(above.size() + below.size() == 3 * n);
    const Clusters all = euclidean_clusters(points.data(), n, 1.0, 1, n);
    CHECK(all.points.size() == n && std::size_t(all.offsets.back()) == n);
    digest("clusters", all.points);
    const Clusters one = euclidean_clusters(points.data(), n, 1000.0, 1, n);
    CHECK(one.offsets.size() == (n == 0 ? 1u : 2u));
  }
  const std::vector<float> same(3000, 2.0f), wide = {0, 0, 0, 3e7f, 3e7f, 3e7f};
  CHECK(voxel_grid(same.data(), 1000, 0.1).size() == 3);
  for (const std::size_t n : kSizes) {
    const auto points = random_floats(3 * n, -20.0f, 20.0f, 3), heights = random_floats(n, 0, 2, 4);
    const Clusters above =
        clusters_above(points.data(), heights.data(), n, {-1.0, 3.0, -1.0}, 1.0, 1, n);
    const Clusters all = euclidean_clusters(points.data(), n, 1.0, 1, n);
    CHECK(above.points.size() == 2 * n && above.offsets.size() == 2 * all.offsets.size() - 1);
    CHECK(std::equal(all.points.begin(), all.points.end(), above.points.begin()));
    const Segments segments = segments_of(above, points.data(), heights.data());
    CHECK(segments.points.size() == 3 * above.points.size());
    CHECK(segments.centroids.size() == 3 * segments.heights.size());
  }
  CHECK(euclidean_clusters(same.data(), 1000, 0.1, 1, 1000).offsets.size() == 2);
  CHECK(plane_normals(same.data(), 1000, {}).empty());
  CHECK_THROWS(plane_normals(wide.data(), 2, {0.1}));
  CHECK_THROWS(voxel_grid(wide.data(), 2, 1e-6));
  CHECK_THROWS(voxel_grid(wide.data(), 2, 0.0));
  CHECK_THROWS(heights_above_ground(wide.data(), 2, {}));
}

// Nearest points by a grid, compared with a search of all points. Points on a lattice lie equally
// near to many places.
void nearest_points() {
  for (const std::size_t n : kSizes) {
    auto points = random_floats(3 * n, -9.0f, 9.0f, 11),
         places = random_floats(600, -12.0f, 12.0f, 12);
    for (std::vector<float>* each : {&points, &places}) {
      for (std::size_t i = 0; i < each->size() / 2; ++i)
        (*each)[i] = std::round((*each)[i] * 2) / 2;
    }
    const PointGrid grid(points.data(), n, 1.5);
    for (std::size_t k = 0; k < places.size(); k += 3) {
      const PointGrid::Point p = {places[k], places[k + 1], places[k + 2]};
      std::vector<float> squared = {1e9f, 1e9f};
      for (std::size_t i = 0; i < n; ++i) {
        const float dx = grid[i][0] - p[0], dy = grid[i][1] - p[1], dz = grid[i][2] - p[2];
        squared.push_back(dx * dx + dy * dy + dz * dz);
      }
      std::sort(squared.begin(), squared.end());
      const bool near = squared[0] <= 2.25f;
      CHECK(grid.is_near(p, 2.25f) == near);
      CHECK(near ? grid.nearest_squared(p, 2.25f) == squared[0]
                 : grid.nearest_squared(p, 2.25f) > 2.25f);
      const PointGrid::Nearest found = grid.nearest(p, 1.5f);
      CHECK((found.point == PointGrid::kNone) == !near);
      CHECK(found.squared == std::min(squared[0], 2.25f));
      CHECK(found.next == std::min(squared[1], 2.25f));
      PointGrid::Nearest first{PointGrid::kNone, 2.25f, 2.25f};  // of those equally near
      grid.visit(p, 1.5, [&](std::uint32_t i, float d) {
        const bool nearer = d < first.squared || (d == 2.25f && first.point == PointGrid::kNone);
        if (nearer) first = {i, d, d};
      });
      CHECK(found.point == first.point);
      const double clear = grid.clearance(p, 1.5);
      CHECK(clear >= 0.0 && clear <= 4.5 && clear <= std::sqrt(squared[0]) + 1e-6);
    }
    CHECK(grid.clearance({1e9f, 0, 0}, 1.5) == 0.0 && !grid.is_near({1e9f, 0, 0}, 2.25f));
  }
}

}  // namespace
}  // namespace segloc

void segmentation_tests() {
  for (const segloc::Isa isa : instruction_sets()) {
    segloc::kernels_agree(isa);
    segloc::grounds_agree(isa);
    segloc::sums_agree(isa);
  }
  segloc::clouds();
  segloc::nearest_points();
}
