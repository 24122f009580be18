// Poses from matches.
#include <algorithm>
#include <limits>
#include <utility>
#include <vector>

#include "bindings/bindings.h"
#include "bindings/rigid.h"
#include "common/angles.h"
#include "common/portability.h"
#include "common/rigid.h"
#include "proposals/pose/agreement.h"
#include "proposals/pose/consensus.h"
#include "proposals/pose/consistency.h"
#include "proposals/pose/match_table.h"
#include "proposals/pose/prosac.h"

namespace segloc::bindings {
namespace {

// Indices must be valid and positions finite. Only matched map segments are read; they are all over
// the map, so they are prefetched.
void require_matches(const In2<double>& query, const In2<double>& map,
                     const In1<std::int64_t>& match_query, const In1<std::int64_t>& match_map) {
  constexpr std::size_t kAhead = 24;
  require(query.shape(1) == 3, "query must have shape (N, 3)");
  require(map.shape(1) == 3, "map must have shape (N, 3)");
  const std::size_t n = match_query.shape(0);
  require(match_map.shape(0) == n, "match_query and match_map must have the same length");
  require(n <= std::numeric_limits<std::uint32_t>::max(), "there are too many matches");
  const auto inside = [](std::int64_t i, std::size_t count) {
    return i >= 0 && static_cast<std::size_t>(i) < count;
  };
  for (std::size_t k = 0; k < n; ++k) {
    require(
        inside(match_query.data()[k], query.shape(0)) && inside(match_map.data()[k], map.shape(0)),
        "a match names a segment that does not exist");
  }
  require_usable(query.data(), query.size(), "query");
  for (std::size_t k = 0; k < n; ++k) {
    prefetch(map.data() + 3 * match_map.data()[std::min(k + kAhead, n - 1)]);
    require_usable(map.data() + 3 * match_map.data()[k], 3, "map");
  }
}

// Smaller tolerances would need too many cells.
constexpr double kLeastTolerance = 1e-3;
constexpr std::size_t kMostDraws = 1'000'000'000;

auto consensus_(const In2<double>& query, const In2<double>& map,
                const In1<std::int64_t>& match_query, const In1<std::int64_t>& match_map,
                double inlier_tolerance, double height_tolerance, double distinct_radius,
                double separation, double separation_deg, std::size_t max_refined,
                std::size_t max_hypotheses, int threads) {
  require_matches(query, map, match_query, match_map);
  require_between(inlier_tolerance, kLeastTolerance, 1e6, "inlier_tolerance");
  require_between(height_tolerance, 0.0, kLongest, "height_tolerance");
  require_between(distinct_radius, 0.0, kLongest, "distinct_radius");
  require_between(separation, 0.0, kLongest, "separation");
  require_between(separation_deg, 0.0, 180.0, "separation_deg");
  const std::size_t n = match_query.shape(0);
  ConsensusOptions options;
  options.inlier_tolerance = inlier_tolerance;
  options.height_tolerance = height_tolerance;
  options.distinct_radius = distinct_radius;
  options.separation = separation;
  options.separation_angle = separation_deg * kPi / 180.0;
  options.max_refined = max_refined;
  options.max_hypotheses = max_hypotheses;
  std::vector<PoseHypothesis> found;
  {
    nb::gil_scoped_release release;
    found = consensus(query.data(), query.shape(0), map.data(), match_query.data(),
                      match_map.data(), n, options, threads);
  }
  std::vector<double> poses, scores;
  std::vector<std::int64_t> inliers;
  for (const PoseHypothesis& h : found) {
    const double c = std::cos(h.yaw), s = std::sin(h.yaw);
    poses.insert(poses.end(), {c, -s, 0, h.t[0], s, c, 0, h.t[1], 0, 0, 1, h.t[2], 0, 0, 0, 1});
    inliers.push_back(static_cast<std::int64_t>(h.inliers));
    scores.push_back(h.score);
  }
  return std::make_tuple(to_numpy(std::move(poses), {found.size(), 4, 4}),
                         to_numpy(std::move(inliers)), to_numpy(std::move(scores)));
}

auto prosac_(const In2<double>& query, const In2<double>& map, const In1<std::int64_t>& match_query,
             const In1<std::int64_t>& match_map, bool ordered, double edge_tolerance,
             double inlier_tolerance, double min_edge, double chance, double separation,
             double separation_deg, std::size_t max_draws, std::size_t max_hypotheses,
             std::uint64_t seed) {
  require_matches(query, map, match_query, match_map);
  require_between(edge_tolerance, 0.0, kLongest, "edge_tolerance");
  require_between(inlier_tolerance, 0.0, kLongest, "inlier_tolerance");
  require_between(min_edge, 0.0, kLongest, "min_edge");
  require_between(chance, 0.0, 1.0, "chance");
  require_between(separation, 0.0, kLongest, "separation");
  require_between(separation_deg, 0.0, 180.0, "separation_deg");
  require(max_draws <= kMostDraws, "max_draws must be at most " + std::to_string(kMostDraws));
  ProsacOptions options;
  options.ordered = ordered;
  options.edge_tolerance = edge_tolerance;
  options.inlier_tolerance = inlier_tolerance;
  options.min_edge = min_edge;
  options.chance = chance;
  options.separation = separation;
  options.separation_angle = separation_deg * kPi / 180.0;
  options.max_draws = max_draws;
  options.max_hypotheses = max_hypotheses;
  options.seed = seed;
  std::vector<double> poses;
  std::vector<std::int64_t> inliers;
  {
    nb::gil_scoped_release release;
    const std::size_t n = match_query.shape(0);
    std::vector<double> source, target;
    for (std::size_t k = 0; k < n; ++k) {
      const double* a = query.data() + 3 * match_query.data()[k];
      const double* b = map.data() + 3 * match_map.data()[k];
      source.insert(source.end(), a, a + 3);
      target.insert(target.end(), b, b + 3);
    }
    for (const SampledHypothesis& h :
         prosac(source.data(), target.data(), match_query.data(), match_map.data(), n, options)) {
      append_matrix(h.T, poses);
      inliers.push_back(static_cast<std::int64_t>(h.inliers));
    }
  }
  const std::size_t found = inliers.size();
  return std::make_tuple(to_numpy(std::move(poses), {found, 4, 4}), to_numpy(std::move(inliers)));
}

auto consistent_sets_(const In2<double>& query, const In2<double>& map,
                      const In1<std::int64_t>& match_query, const In1<std::int64_t>& match_map,
                      const In1<std::int64_t>& objects, double resolution, std::size_t min_size,
                      std::size_t max_sets) {
  require_matches(query, map, match_query, match_map);
  require(objects.shape(0) == query.shape(0), "objects must have one entry for each query segment");
  require_between(resolution, kLeastTolerance, 1e6, "resolution");
  require(min_size >= 3, "min_size must be at least 3");
  const ConsistencyOptions options{resolution, min_size, max_sets};
  std::vector<double> poses;
  std::vector<std::int64_t> members, offsets = {0};
  {
    nb::gil_scoped_release release;
    const std::size_t n = match_query.shape(0);
    std::vector<double> source, target;
    std::vector<std::int64_t> object;
    for (std::size_t k = 0; k < n; ++k) {
      const double* a = query.data() + 3 * match_query.data()[k];
      const double* b = map.data() + 3 * match_map.data()[k];
      source.insert(source.end(), a, a + 3);
      target.insert(target.end(), b, b + 3);
      object.push_back(objects.data()[match_query.data()[k]]);
    }
    for (const ConsistentSet& set : consistent_sets(source.data(), target.data(), object.data(),
                                                    match_map.data(), n, options)) {
      append_matrix(set.T, poses);
      members.insert(members.end(), set.members.begin(), set.members.end());
      offsets.push_back(static_cast<std::int64_t>(members.size()));
    }
  }
  const std::size_t found = offsets.size() - 1;
  return std::make_tuple(to_numpy(std::move(poses), {found, 4, 4}), to_numpy(std::move(members)),
                         to_numpy(std::move(offsets)));
}

Agreement agreement_of(const In2<double>& query, const In2<double>& map,
                       const In1<std::int64_t>& match_query, const In1<std::int64_t>& match_map,
                       double distinct_radius, double inlier_tolerance, double height_tolerance) {
  require_matches(query, map, match_query, match_map);
  require_between(distinct_radius, 0.0, kLongest, "distinct_radius");
  require_between(inlier_tolerance, 0.0, kLongest, "inlier_tolerance");
  require_between(height_tolerance, 0.0, kLongest, "height_tolerance");
  nb::gil_scoped_release release;
  const std::vector<std::uint32_t> objects =
      objects_of(query.data(), query.shape(0), distinct_radius);
  std::vector<Agreement::Match> matches(match_query.shape(0));
  for (std::size_t k = 0; k < matches.size(); ++k) {
    const auto row = static_cast<std::size_t>(match_query.data()[k]);
    std::copy_n(query.data() + 3 * row, 3, matches[k].from);
    std::copy_n(map.data() + 3 * match_map.data()[k], 3, matches[k].to);
    matches[k].object = objects[row];
  }
  return {std::move(matches), objects.size(), {inlier_tolerance, height_tolerance}};
}

}  // namespace

void bind_pose(nb::module_& m) {
  nb::class_<Agreement>(m, "Agreement")
      .def(
          "__init__",
          [](Agreement* self, const In2<double>& query, const In2<double>& map,
             const In1<std::int64_t>& match_query, const In1<std::int64_t>& match_map,
             double distinct_radius, double inlier_tolerance, double height_tolerance) {
            new (self) Agreement(agreement_of(query, map, match_query, match_map, distinct_radius,
                                              inlier_tolerance, height_tolerance));
          },
          nb::arg("query").noconvert(), nb::arg("map").noconvert(),
          nb::arg("match_query").noconvert(), nb::arg("match_map").noconvert(),
          nb::arg("distinct_radius"), nb::arg("inlier_tolerance"), nb::arg("height_tolerance"))
      .def(
          "count",
          [](const Agreement& self, const In2<double>& T_map_local) {
            return self.count(rigid_of(T_map_local, "T_map_local"));
          },
          nb::arg("T_map_local").noconvert());

  m.def("consensus", &consensus_, nb::arg("query").noconvert(), nb::arg("map").noconvert(),
        nb::arg("match_query").noconvert(), nb::arg("match_map").noconvert(),
        nb::arg("inlier_tolerance"), nb::arg("height_tolerance"), nb::arg("distinct_radius"),
        nb::arg("separation"), nb::arg("separation_deg"), nb::arg("max_refined"),
        nb::arg("max_hypotheses"), nb::arg("threads"));

  m.def("prosac", &prosac_, nb::arg("query").noconvert(), nb::arg("map").noconvert(),
        nb::arg("match_query").noconvert(), nb::arg("match_map").noconvert(), nb::arg("ordered"),
        nb::arg("edge_tolerance"), nb::arg("inlier_tolerance"), nb::arg("min_edge"),
        nb::arg("chance"), nb::arg("separation"), nb::arg("separation_deg"), nb::arg("max_draws"),
        nb::arg("max_hypotheses"), nb::arg("seed"));

  m.def("consistent_sets", &consistent_sets_, nb::arg("query").noconvert(),
        nb::arg("map").noconvert(), nb::arg("match_query").noconvert(),
        nb::arg("match_map").noconvert(), nb::arg("objects").noconvert(), nb::arg("resolution"),
        nb::arg("min_size"), nb::arg("max_sets"));
}

}  // namespace segloc::bindings
