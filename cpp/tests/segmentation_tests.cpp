// Segmentation at every size from nothing up.

#include "segmentation/cluster.h"
#include "segmentation/ground.h"
#include "segmentation/planes.h"
#include "segmentation/voxel.h"
#include "tests/check.h"

namespace segloc {
namespace {

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
    const Clusters all = euclidean_clusters(points.data(), n, 1.0, 1, n);
    CHECK(all.points.size() == n && std::size_t(all.offsets.back()) == n);
    digest("clusters", all.points);
    const Clusters one = euclidean_clusters(points.data(), n, 1000.0, 1, n);
    CHECK(one.offsets.size() == (n == 0 ? 1u : 2u));
  }
  const std::vector<float> same(3000, 2.0f), wide = {0, 0, 0, 3e7f, 3e7f, 3e7f};
  CHECK(voxel_grid(same.data(), 1000, 0.1).size() == 3);
  CHECK(euclidean_clusters(same.data(), 1000, 0.1, 1, 1000).offsets.size() == 2);
  CHECK(plane_normals(same.data(), 1000, {}).empty());
  CHECK_THROWS(plane_normals(wide.data(), 2, {0.1}));
  CHECK_THROWS(voxel_grid(wide.data(), 2, 1e-6));
  CHECK_THROWS(voxel_grid(wide.data(), 2, 0.0));
  CHECK_THROWS(heights_above_ground(wide.data(), 2, {}));
}

}  // namespace
}  // namespace segloc

void segmentation_tests() { segloc::clouds(); }
