// Segmentation, pose and verification kernels at every size from nothing up.
#include <atomic>
#include <cmath>
#include <stdexcept>

#include "check.h"
#include "cluster.h"
#include "consensus.h"
#include "gicp.h"
#include "ground.h"
#include "lzf.h"
#include "parallel.h"
#include "point_index.h"
#include "prosac.h"
#include "surface.h"
#include "voxel.h"

namespace segloc {
namespace {

const std::size_t kSizes[] = {0, 1, 2, 3, 17, 255, 256, 257, 4000};

void clouds() {
  for (const std::size_t n : kSizes) {
    const auto points = random_floats(3 * n, -20.0f, 20.0f, 1);
    const auto voxels = voxel_grid(points.data(), n, 1.5);
    CHECK(voxels.size() % 3 == 0 && voxels.size() <= 3 * n && (n == 0 || !voxels.empty()));
    CHECK(heights_above_ground(points.data(), n, {}).size() == n);
    const Clusters all = euclidean_clusters(points.data(), n, 1.0, 1, n);
    CHECK(all.points.size() == n && std::size_t(all.offsets.back()) == n);
    const Clusters one = euclidean_clusters(points.data(), n, 1000.0, 1, n);
    CHECK(one.offsets.size() == (n == 0 ? 1u : 2u));
    const PointIndex index(points.data(), n, 0.5);
    const double identity[16] = {1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1};
    CHECK(index.overlap(points.data(), n, identity, 0.5).near == n);
    CHECK(index.sample(0, 0, 1000, n + 1).size() == 3 * n && index.sample(500, 0, 1, 9).empty());
    const double away[16] = {1, 0, 0, 1e9, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1};
    CHECK(index.overlap(points.data(), n, away, 0.5).near == 0);
  }
  const std::vector<float> same(3000, 2.0f), wide = {0, 0, 0, 3e7f, 3e7f, 3e7f};
  CHECK(voxel_grid(same.data(), 1000, 0.1).size() == 3);
  CHECK(euclidean_clusters(same.data(), 1000, 0.1, 1, 1000).offsets.size() == 2);
  CHECK_THROWS(voxel_grid(wide.data(), 2, 1e-6));
  CHECK_THROWS(voxel_grid(wide.data(), 2, 0.0));
  CHECK_THROWS(heights_above_ground(wide.data(), 2, {}));
}

void poses() {
  std::mt19937 engine(3);
  std::uniform_real_distribution<double> uniform(-40.0, 40.0);
  for (const std::size_t n : kSizes) {
    std::vector<double> query(3 * n), map(3 * n);
    std::vector<std::int64_t> index(n);
    const double yaw = 0.7, c = std::cos(yaw), s = std::sin(yaw);
    for (std::size_t i = 0; i < n; ++i) {
      double* q = &query[3 * i];
      for (int a = 0; a < 3; ++a) q[a] = uniform(engine) * (a == 2 ? 0.1 : 1.0);
      const double moved[3] = {c * q[0] - s * q[1] + 5e6, s * q[0] + c * q[1] - 4e5, q[2] + 7.0};
      for (int a = 0; a < 3; ++a) map[3 * i + a] = i % 2 ? moved[a] : uniform(engine);
      index[i] = std::int64_t(i);
    }
    const auto found = consensus(query.data(), n, map.data(), index.data(), index.data(), n,
                                 ConsensusOptions{}, 2);
    const auto sampled = prosac(query.data(), map.data(), index.data(), index.data(), n, {});
    if (n < 200) continue;
    CHECK(std::fabs(found[0].yaw - yaw) < 0.01 && found[0].inliers > n / 10);
    CHECK(std::fabs(found[0].t[0] - 5e6) < 0.5 && std::fabs(sampled[0].T.t[0] - 5e6) < 0.5);
  }
}

void registration() {
  for (const std::size_t n : kSizes) {
    auto points = random_floats(3 * n, -8.0f, 8.0f, 7);
    for (std::size_t i = 0; i < n; ++i) points[3 * i + i % 3] = -8.0f;  // three walls
    const Surface site(points.data(), n, 1.5, 1.6);
    Rigid start;
    start.t = {0.2, -0.1, 0.15};
    const GicpResult one = align(site, site, start, {}, 1), two = align(site, site, start, {}, 2);
    CHECK(one.T.t == two.T.t && one.T.R == two.T.R && one.H == two.H);
    CHECK(one.inliers <= n && std::isfinite(one.error));
    if (n < 1000) continue;
    for (const double t : one.T.t) CHECK(std::fabs(t) < 0.05);
    start.t = {1e9, 0, 0};
    CHECK(align(site, site, start, {}, 2).inliers == 0);
    start.t = {std::nan(""), 0, 0};
    CHECK(align(site, site, start, {}, 2).inliers == 0);
  }
}

void decompression() {
  const std::vector<std::uint8_t> literal = {2, 'a', 'b', 'c'};
  CHECK(lzf_decompress(literal.data(), literal.size(), 3).size() == 3);
  std::mt19937 engine(5);
  for (int round = 0; round < 2000; ++round) {  // garbage is refused, and never read past its end
    std::vector<std::uint8_t> data(engine() % 40);
    for (auto& byte : data) byte = std::uint8_t(engine());
    try {
      CHECK(lzf_decompress(data.data(), data.size(), 64).size() == 64);
    } catch (const std::exception&) {
    }
  }
}

void threads() {
  for (const int workers : {1, 2, 8}) {
    std::vector<std::atomic<int>> seen(1000);
    parallel_for(1000, 7, workers, [&](std::size_t begin, std::size_t end, int worker) {
      CHECK(worker >= 0 && worker < workers);
      parallel_for(3, 1, 2, [&](std::size_t, std::size_t, int) {});
      for (std::size_t i = begin; i < end; ++i) ++seen[i];
    });
    for (const auto& count : seen) CHECK(count == 1);
  }
  const auto stop = [](std::size_t begin, std::size_t, int) {
    if (begin == 50) throw std::runtime_error("stop");
  };
  CHECK_THROWS(parallel_for(100, 1, 4, stop));
}

}  // namespace
}  // namespace segloc

void geometry_tests() {
  segloc::clouds();
  segloc::poses();
  segloc::registration();
  segloc::decompression();
  segloc::threads();
}
