// Segmentation, pose and verification kernels.
#include "bindings.h"

#include "cluster.h"
#include "consensus.h"
#include "ground.h"
#include "point_index.h"
#include "pose_votes.h"
#include "prosac.h"
#include "sight.h"
#include "voxel.h"

namespace segloc::bindings {
namespace {

void require_points(const In2<float>& points) {
  require(points.shape(1) == 3, "points must have shape (N, 3)");
}

Out<float> voxel_grid_(const In2<float>& points, double size) {
  require_points(points);
  std::vector<float> means;
  {
    nb::gil_scoped_release release;
    means = voxel_grid(points.data(), points.shape(0), size);
  }
  const std::size_t count = means.size() / 3;
  return to_numpy(std::move(means), {count, 3});
}

Out<float> heights_above_ground_(const In2<float>& points, double cell, double max_slope,
                                 double outlier) {
  require_points(points);
  std::vector<float> heights;
  {
    nb::gil_scoped_release release;
    heights = heights_above_ground(points.data(), points.shape(0), {cell, max_slope, outlier});
  }
  return to_numpy(std::move(heights));
}

auto euclidean_clusters_(const In2<float>& points, double radius, std::size_t min_points,
                         std::size_t max_points) {
  require_points(points);
  Clusters clusters;
  {
    nb::gil_scoped_release release;
    clusters = euclidean_clusters(points.data(), points.shape(0), radius, min_points, max_points);
  }
  return std::make_tuple(to_numpy(std::move(clusters.points)), to_numpy(std::move(clusters.offsets)));
}

void require_matches(const In1<std::int64_t>& match_query, std::size_t queries,
                     const In1<std::int64_t>& match_map, std::size_t segments) {
  require(match_map.shape(0) == match_query.shape(0),
          "match_query and match_map must have the same length");
  for (std::size_t k = 0; k < match_query.shape(0); ++k) {
    const std::int64_t q = match_query.data()[k], m = match_map.data()[k];
    require(q >= 0 && static_cast<std::size_t>(q) < queries && m >= 0 &&
                static_cast<std::size_t>(m) < segments,
            "a match names a segment that does not exist");
  }
}

auto consensus_(const In2<double>& query, const In2<double>& map,
                const In1<std::int64_t>& match_query, const In1<std::int64_t>& match_map,
                double inlier_tolerance, double height_tolerance, double distinct_radius,
                double separation, std::size_t max_refined, std::size_t max_hypotheses,
                int threads) {
  require(query.shape(1) == 3 && map.shape(1) == 3, "centroids must have shape (N, 3)");
  require_matches(match_query, query.shape(0), match_map, map.shape(0));
  const std::size_t n = match_query.shape(0);
  ConsensusOptions options;
  options.inlier_tolerance = inlier_tolerance;
  options.height_tolerance = height_tolerance;
  options.distinct_radius = distinct_radius;
  options.separation = separation;
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

auto pose_votes_(const In2<double>& query, const In2<double>& map,
                 const In1<std::int64_t>& match_query, const In1<std::int64_t>& match_map,
                 double tolerance, double distinct_radius, std::size_t max_cells, int threads) {
  require(query.shape(1) == 3 && map.shape(1) == 3, "centroids must have shape (N, 3)");
  require_matches(match_query, query.shape(0), match_map, map.shape(0));
  const MatchInput input = {query.data(), query.shape(0), map.data(), match_query.data(),
                            match_map.data(), match_query.shape(0)};
  VoteOptions options;
  options.tolerance = tolerance;
  options.max_cells = max_cells;
  const double origin[3] = {0.0, 0.0, 0.0}, reach = 100.0;
  PoseVotes found;
  {
    nb::gil_scoped_release release;
    found = vote_for_poses(make_field(input, origin, distinct_radius, reach), options, threads);
  }
  std::vector<std::int64_t> votes;
  std::vector<double> poses;
  for (const PoseCell& cell : found.cells) {
    votes.push_back(cell.votes);
    poses.insert(poses.end(), {cell.yaw, cell.x, cell.y});
  }
  const std::size_t count = votes.size();
  return std::make_tuple(to_numpy(std::move(votes)), to_numpy(std::move(poses), {count, 3}),
                         found.width, found.turn);
}

auto prosac_(const In2<double>& query, const In2<double>& map,
             const In1<std::int64_t>& match_query, const In1<std::int64_t>& match_map, bool ordered,
             bool yaw_only, double edge_tolerance, double inlier_tolerance, double min_edge,
             double chance, double separation, std::size_t max_draws, std::size_t max_hypotheses,
             std::uint64_t seed) {
  require(query.shape(1) == 3 && map.shape(1) == 3, "centroids must have shape (N, 3)");
  require_matches(match_query, query.shape(0), match_map, map.shape(0));
  ProsacOptions options;
  options.ordered = ordered;
  options.yaw_only = yaw_only;
  options.edge_tolerance = edge_tolerance;
  options.inlier_tolerance = inlier_tolerance;
  options.min_edge = min_edge;
  options.chance = chance;
  options.separation = separation;
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
      const double *a = query.data() + 3 * match_query.data()[k];
      const double *b = map.data() + 3 * match_map.data()[k];
      source.insert(source.end(), a, a + 3);
      target.insert(target.end(), b, b + 3);
    }
    for (const SampledHypothesis& h : prosac(source.data(), target.data(), match_query.data(),
                                             match_map.data(), n, options)) {
      append_matrix(h.T, poses);
      inliers.push_back(static_cast<std::int64_t>(h.inliers));
    }
  }
  const std::size_t found = inliers.size();
  return std::make_tuple(to_numpy(std::move(poses), {found, 4, 4}), to_numpy(std::move(inliers)));
}

auto overlap_(const PointIndex& index, const In2<float>& points, const In3<double>& poses,
              double radius) {
  require_points(points);
  require(poses.shape(1) == 4 && poses.shape(2) == 4, "poses must have shape (H, 4, 4)");
  require(radius > 0 && radius <= index.radius(), "radius must be positive and at most the index's");
  std::vector<double> share(poses.shape(0)), rmse(poses.shape(0));
  {
    nb::gil_scoped_release release;
    const std::size_t m = points.shape(0);
    for (std::size_t h = 0; h < share.size(); ++h) {
      const auto found = index.overlap(points.data(), m, poses.data() + 16 * h, radius);
      share[h] = found.judged == 0 ? 0.0 : double(found.near) / double(found.judged);
      rmse[h] = std::sqrt(found.squared_sum / double(found.near));  // NaN where nothing is near
    }
  }
  return std::make_tuple(to_numpy(std::move(share)), to_numpy(std::move(rmse)));
}

auto look_(const Sight& sight, const In2<float>& site, const In2<double>& T_local_site, double radius,
           double margin) {
  require_points(site);
  require(T_local_site.shape(0) == 4 && T_local_site.shape(1) == 4, "T_local_site must have shape (4, 4)");
  require(radius > 0 && radius <= sight.radius(), "radius must be positive and at most the view's");
  require(margin >= 0, "margin must not be negative");
  nb::gil_scoped_release release;
  const Sight::Counts counts = sight.look(site.data(), site.shape(0), T_local_site.data(), radius, margin);
  return std::make_tuple(counts.seen, counts.through);
}

}  // namespace

void bind_geometry(nb::module_& m) {
  m.def("voxel_grid", &voxel_grid_, nb::arg("points").noconvert(), nb::arg("size"));
  m.def("heights_above_ground", &heights_above_ground_, nb::arg("points").noconvert(),
        nb::arg("cell"), nb::arg("max_slope"), nb::arg("outlier"));
  m.def("euclidean_clusters", &euclidean_clusters_, nb::arg("points").noconvert(),
        nb::arg("radius"), nb::arg("min_points"), nb::arg("max_points"));
  m.def("consensus", &consensus_, nb::arg("query").noconvert(), nb::arg("map").noconvert(),
        nb::arg("match_query").noconvert(), nb::arg("match_map").noconvert(),
        nb::arg("inlier_tolerance"), nb::arg("height_tolerance"), nb::arg("distinct_radius"),
        nb::arg("separation"), nb::arg("max_refined"), nb::arg("max_hypotheses"),
        nb::arg("threads"));

  m.def("pose_votes", &pose_votes_, nb::arg("query").noconvert(), nb::arg("map").noconvert(),
        nb::arg("match_query").noconvert(), nb::arg("match_map").noconvert(),
        nb::arg("tolerance"), nb::arg("distinct_radius"), nb::arg("max_cells"),
        nb::arg("threads"));

  m.def("prosac", &prosac_, nb::arg("query").noconvert(), nb::arg("map").noconvert(),
        nb::arg("match_query").noconvert(), nb::arg("match_map").noconvert(), nb::arg("ordered"),
        nb::arg("yaw_only"), nb::arg("edge_tolerance"), nb::arg("inlier_tolerance"),
        nb::arg("min_edge"), nb::arg("chance"), nb::arg("separation"), nb::arg("max_draws"),
        nb::arg("max_hypotheses"), nb::arg("seed"));

  nb::class_<Sight>(m, "Sight")
      .def("__init__",
           [](Sight* self, const In2<float>& structure, const In2<float>& ground, double range,
              double bin_deg, double radius) {
             require_points(structure);
             require_points(ground);
             require(range > 0 && range <= 1000 && radius > 0, "range and radius must be positive");
             require(bin_deg >= 0.1 && bin_deg <= 10, "bin_deg must be between 0.1 and 10");
             new (self) Sight(structure.data(), structure.shape(0), ground.data(), ground.shape(0), range,
                              bin_deg, radius);
           },
           nb::arg("structure").noconvert(), nb::arg("ground").noconvert(), nb::arg("range"),
           nb::arg("bin_deg"), nb::arg("radius"))
      .def("look", &look_, nb::arg("site").noconvert(), nb::arg("T_local_site").noconvert(),
           nb::arg("radius"), nb::arg("margin"));

  nb::class_<PointIndex>(m, "PointIndex")
      .def("__init__",
           [](PointIndex* self, const In2<float>& points, double radius) {
             require_points(points);
             new (self) PointIndex(points.data(), points.shape(0), radius);
           },
           nb::arg("points").noconvert(), nb::arg("radius"))
      .def("__len__", &PointIndex::size)
      .def("overlap", &overlap_, nb::arg("points").noconvert(), nb::arg("poses").noconvert(),
           nb::arg("radius"))
      .def("sample",
           [](const PointIndex& index, double x, double y, double radius, std::size_t count) {
             require(count > 0, "count must be positive");
             std::vector<float> points = index.sample(x, y, radius, count);
             const std::size_t rows = points.size() / 3;
             return to_numpy(std::move(points), {rows, 3});
           },
           nb::arg("x"), nb::arg("y"), nb::arg("radius"), nb::arg("count"));
}

}  // namespace segloc::bindings
