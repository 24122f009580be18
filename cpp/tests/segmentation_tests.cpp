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

// Every instruction set finds the same cells and the same order.
void kernels_agree(Isa isa) {
  const Kernels &k = kernels(isa), &portable = kernels(Isa::portable);
  for (const std::size_t n : kSizes) {
    const auto values = random_floats(3 * n + 15, -9.0f, 9.0f, 21);
    std::vector<std::int32_t> cells(n), expected_cells(n);
    k.cell_numbers(values.data(), n, 0.3, cells.data());
    portable.cell_numbers(values.data(), n, 0.3, expected_cells.data());
    CHECK(cells == expected_cells);
    for (std::size_t i = 0; i < n; ++i) CHECK(cells[i] == std::floor(values[i] / 0.3));
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
// near to many places: every instruction set finds the same one.
void nearest_points(Isa isa) {
  const Kernels &kernel = kernels(isa), &portable = kernels(Isa::portable);
  constexpr float kLimit = 2.25f, kLead = 0.5f;
  for (const std::size_t n : kSizes) {
    auto points = random_floats(3 * n, -9.0f, 9.0f, 11),
         places = random_floats(600, -12.0f, 12.0f, 12);
    for (std::vector<float>* each : {&points, &places}) {
      for (std::size_t i = 0; i < each->size() / 2; ++i)
        (*each)[i] = std::round((*each)[i] * 2) / 2;
    }
    places.insert(places.end(), {1e9f, 0, 0, -kInfinity, 0, 0, std::nanf(""), 0, 0});
    const std::size_t count = places.size() / 3;
    const PointGrid grid(points.data(), n, 1.5);
    std::vector<float> least(count), any(count);
    std::vector<GridNearest> nearest(count), expected(count);
    std::vector<PointSums> sums(count);
    const GridCells cells = grid.cells();
    kernel.nearest_squared(cells, places.data(), count, kLimit, -1.0f, least.data());
    kernel.nearest_squared(cells, places.data(), count, kLimit, 1.0f, any.data());
    kernel.nearest_points(cells, places.data(), count, kLimit, kLead, nearest.data());
    kernel.sums_within(cells, places.data(), count, kLimit, sums.data());
    portable.nearest_points(cells, places.data(), count, kLimit, kLead, expected.data());
    for (std::size_t k = 0; k < count; ++k) {
      const float* p = &places[3 * k];
      std::vector<float> squared;
      std::uint32_t within = 0;
      double x = 0;
      for (std::size_t i = 0; i < n; ++i) {
        const float dx = grid[i][0] - p[0], dy = grid[i][1] - p[1], dz = grid[i][2] - p[2];
        squared.push_back(dx * dx + dy * dy + dz * dz);
        within += squared[i] <= kLimit;
        x += squared[i] <= kLimit ? double{grid[i][0]} - p[0] : 0.0;
      }
      CHECK(sums[k].count == within && std::fabs(sums[k].first[0] - x) < 1e-9);
      const GridNearest found = nearest[k];
      CHECK(found.point == expected[k].point && found.next == expected[k].next);
      float first = kInfinity, second = kInfinity;  // and of all others
      for (std::size_t i = 0; i < n; ++i) {
        first = std::min(first, squared[i]);
        if (i != found.point) second = std::min(second, squared[i]);
      }
      CHECK((found.point == kNoPoint) == (within == 0));
      CHECK(found.next <= second && (found.next == second || found.next > kLead));
      CHECK(within == 0 ? least[k] > kLimit && any[k] > kLimit : least[k] == first);
      if (within == 0) continue;
      CHECK(found.squared == first && squared[found.point] == first);
      CHECK(any[k] == first || any[k] <= 1.0f);
    }
  }
}

}  // namespace
}  // namespace segloc

void segmentation_tests() {
  for (const segloc::Isa isa : instruction_sets()) {
    segloc::kernels_agree(isa);
    segloc::grounds_agree(isa);
    segloc::sums_agree(isa);
    segloc::nearest_points(isa);
  }
  segloc::clouds();
}
