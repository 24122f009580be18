// Poses from matches at every size from nothing up.
#include <algorithm>
#include <cmath>
#include <cstdint>
#include <random>
#include <vector>

#include "proposals/pose/consensus.h"
#include "proposals/pose/consistency.h"
#include "proposals/pose/prosac.h"
#include "simd/kernels.h"
#include "tests/check.h"

namespace segloc {
namespace {

constexpr double kApart = 0.26;  // radians

ConsensusOptions consensus_options() {
  ConsensusOptions options{};
  options.inlier_tolerance = 0.6;
  options.height_tolerance = options.distinct_radius = 1.0;
  options.separation = 3.0;
  options.separation_angle = kApart;
  options.max_refined = 128;
  options.max_hypotheses = 8;
  return options;
}

ProsacOptions prosac_options() {
  ProsacOptions options{};
  options.ordered = true;
  options.edge_tolerance = 0.5;
  options.inlier_tolerance = 0.6;
  options.min_edge = options.separation = 3.0;
  options.separation_angle = kApart;
  options.chance = 0.01;
  options.max_draws = 200000;
  options.max_hypotheses = 8;
  return options;
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
                                 consensus_options(), 2);
    const auto sampled =
        prosac(query.data(), map.data(), index.data(), index.data(), n, prosac_options());
    for (const PoseHypothesis& pose : found) {
      digest("consensus", std::vector<double>{pose.yaw, pose.t[0], pose.t[1], pose.t[2]});
    }
    for (const SampledHypothesis& pose : sampled) digest("prosac", pose.T.t);
    const auto sets =
        consistent_sets(query.data(), map.data(), index.data(), index.data(), n, {0.4, 4, 8});
    if (n < 200) continue;
    CHECK(sets[0].members.size() >= std::min(n / 2, kMostPartners));
    CHECK(std::fabs(sets[0].T.t[0] - 5e6) < 0.5);
    CHECK(std::fabs(found[0].yaw - yaw) < 0.01 && found[0].inliers > n / 10);
    CHECK(std::fabs(found[0].t[0] - 5e6) < 0.5 && std::fabs(sampled[0].T.t[0] - 5e6) < 0.5);
  }
}

// Segments that are absurdly far away change nothing for the others.
void far_segments() {
  const std::size_t n = 40;
  const auto points = random_floats(3 * n, -40.0f, 40.0f, 3);
  std::vector<double> query(points.begin(), points.end()), map(query);
  std::vector<std::int64_t> index(n);
  for (std::size_t i = 0; i < n; ++i) index[i] = std::int64_t(i);
  map[3 * n - 3] = 1e10;
  map[3 * n - 5] = -1e10;
  for (const int threads : {1, 3}) {
    const auto found = consensus(query.data(), n, map.data(), index.data(), index.data(), n,
                                 consensus_options(), threads);
    CHECK(!found.empty() && found[0].inliers + 6 >= n);
    CHECK(std::hypot(found[0].t[0], found[0].t[1]) < 0.1);
  }
}

// Every instruction set finds the same edges: all that are as long, none that are far from it.
void edges() {
  for (const std::size_t n : kSizes) {
    std::vector<std::vector<float>> columns;
    for (unsigned seed = 0; seed < 6; ++seed) {
      columns.push_back(random_floats(n + 15, -40.0f, 40.0f, seed));
    }
    const auto& c = columns;
    const EdgeArrays arrays = {{c[0].data(), c[1].data(), c[2].data()},
                               {c[3].data(), c[4].data(), c[5].data()}};
    const auto edge = [&](int first, std::size_t i, std::size_t j) {
      double squares = 0.0;
      for (int a = first; a < first + 3; ++a) squares += std::pow(double(c[a][i]) - c[a][j], 2);
      return std::sqrt(squares);
    };
    const std::size_t k = n / 2, begin = n / 3;
    std::vector<std::uint32_t> expected;
    for (const Isa isa : instruction_sets()) {
      std::vector<std::uint32_t> found(n);
      found.resize(kernels(isa).like_edges(arrays, k, 0.5f, begin, n, found.data()));
      if (isa == instruction_sets().front()) expected = found;
      CHECK(found == expected);
      for (std::size_t i = begin, next = 0; i < n; ++i) {
        const bool hit = next < found.size() && found[next] == i;
        next += hit;
        const double difference = std::fabs(edge(0, i, k) - edge(3, i, k));
        CHECK(hit ? difference < 0.51 : difference > 0.49);
      }
    }
  }
}

// Whatever a binding lets through has places in every table, or is refused.
void absurd_segments() {
  const std::size_t n = 60;
  std::vector<std::int64_t> index(n);
  for (std::size_t i = 0; i < n; ++i) index[i] = std::int64_t(i);
  for (const double size : {0.0, 1e-9, 1.0, 1e6, 1e9, 9e14}) {
    for (const double other : {0.0, 1e-9, 1e7, 9e14}) {
      std::vector<double> query(3 * n), map(3 * n);
      for (std::size_t i = 0; i < 3 * n; ++i) {
        query[i] = size * (double(i * 7 % 60) / 30.0 - 1.0);
        map[i] = other * (double(i * 11 % 60) / 30.0 - 1.0);
      }
      ConsensusOptions options;
      options.inlier_tolerance = 1e-3;
      try {
        for (const auto& pose :
             consensus(query.data(), n, map.data(), index.data(), index.data(), n, options, 2)) {
          CHECK(std::isfinite(pose.yaw + pose.t[0] + pose.t[1] + pose.t[2]));
        }
      } catch (const std::invalid_argument&) {
        CHECK(size + other > 1e8);
      }
      for (const auto& pose : prosac(query.data(), map.data(), index.data(), index.data(), n, {})) {
        CHECK(std::isfinite(pose.T.t[0] + pose.T.t[1] + pose.T.t[2]));
      }
      for (const auto& set :
           consistent_sets(query.data(), map.data(), index.data(), index.data(), n, {1e-3, 3, 8})) {
        CHECK(std::isfinite(set.T.t[0] + set.T.t[1] + set.T.t[2]));
      }
    }
  }
}

}  // namespace
}  // namespace segloc

void pose_tests() {
  segloc::poses();
  segloc::far_segments();
  segloc::edges();
  segloc::absurd_segments();
}
