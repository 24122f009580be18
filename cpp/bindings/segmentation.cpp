// Voxel grid, ground, clusters, and rays on meshes.
#include "bindings/bindings.h"
#include "common/cells.h"
#include "frontend/cluster.h"
#include "frontend/ground.h"
#include "frontend/gravity.h"
#include "frontend/mesh_rays.h"
#include "frontend/spacing.h"
#include "frontend/thinning.h"

namespace segloc::bindings {
namespace {

constexpr std::size_t kMostCuts = 255;  // levels are bytes

Out<float> voxel_grid_(const In2<float>& points, double size) {
  require_points(points);
  require_length(size, "size");
  std::vector<float> means;
  {
    nb::gil_scoped_release release;
    require_usable(points.data(), points.size(), "points");
    means = voxel_grid(points.data(), points.shape(0), size);
  }
  const std::size_t count = means.size() / 3;
  return to_numpy(std::move(means), {count, 3});
}

Out<float> central_points_(const In2<float>& points, const In1<double>& origin, double voxel) {
  require_points(points);
  require(origin.size() == 3, "origin must have shape (3,)");
  require_length(voxel, "voxel");
  require_usable(origin.data(), 3, "origin");
  std::vector<float> kept;
  {
    nb::gil_scoped_release release;
    require_usable(points.data(), points.size(), "points");
    const auto rows = central_points(points.data(), points.shape(0), origin.data(), voxel);
    kept.reserve(3 * rows.size());
    for (const std::size_t row : rows) {
      kept.insert(kept.end(), points.data() + 3 * row, points.data() + 3 * row + 3);
    }
  }
  const std::size_t count = kept.size() / 3;
  return to_numpy(std::move(kept), {count, 3});
}

Out<float> heights_above_ground_(const In2<float>& points, double cell, double max_slope,
                                 double outlier) {
  require_points(points);
  require_length(cell, "cell");
  require_between(max_slope, 0.0, 1e6, "max_slope");
  require_between(outlier, 0.0, kLongest, "outlier");
  std::vector<float> heights;
  {
    nb::gil_scoped_release release;
    require_usable(points.data(), points.size(), "points");
    heights = heights_above_ground(points.data(), points.shape(0), {cell, max_slope, outlier});
  }
  return to_numpy(std::move(heights));
}

auto euclidean_clusters_(const In2<float>& points, double radius, std::size_t min_points,
                         std::size_t max_points) {
  require_points(points);
  require_length(radius, "radius");
  Clusters clusters;
  {
    nb::gil_scoped_release release;
    require_usable(points.data(), points.size(), "points");
    clusters = euclidean_clusters(points.data(), points.shape(0), radius, min_points, max_points);
  }
  return std::make_tuple(to_numpy(std::move(clusters.points)),
                         to_numpy(std::move(clusters.offsets)));
}

void require_heights(const In1<float>& heights, const In2<float>& points) {
  require(heights.size() == points.shape(0), "heights must have a value for each point");
}

nb::tuple split_by_height_(const In2<float>& points, const In1<float>& heights, double cut) {
  require_points(points);
  require_heights(heights, points);
  std::vector<float> above, below;
  {
    nb::gil_scoped_release release;
    require_usable(points.data(), points.size(), "points");
    require_usable(heights.data(), heights.size(), "heights");
    split_by_height(points.data(), heights.data(), points.shape(0), cut, above, below);
  }
  const std::size_t high = above.size() / 3, low = below.size() / 3;
  return nb::make_tuple(to_numpy(std::move(above), {high, 3}), to_numpy(std::move(below), {low, 3}));
}

nb::tuple segments_above_(const In2<float>& points, const In1<float>& heights,
                          const std::vector<double>& cuts, double radius, std::size_t min_points,
                          std::size_t max_points) {
  require_points(points);
  require_heights(heights, points);
  require(!cuts.empty() && cuts.size() <= kMostCuts, "there must be from 1 to 255 cuts");
  require_usable(cuts.data(), cuts.size(), "cuts");
  require_length(radius, "radius");
  Clusters clusters;
  Segments found;
  {
    nb::gil_scoped_release release;
    require_usable(points.data(), points.size(), "points");
    require_usable(heights.data(), heights.size(), "heights");
    clusters = clusters_above(points.data(), heights.data(), points.shape(0), cuts, radius,
                              min_points, max_points);
    found = segments_of(clusters, points.data(), heights.data());
  }
  const std::size_t members = clusters.points.size(), count = clusters.offsets.size() - 1;
  return nb::make_tuple(to_numpy(std::move(found.points), {members, 3}),
                        to_numpy(std::move(clusters.offsets)),
                        to_numpy(std::move(found.centroids), {count, 3}),
                        to_numpy(std::move(found.heights)));
}

Out<float> flat_normals_(const In2<float>& points, double range, double voxel_size, double radius,
                         std::size_t min_points, double thickness, std::size_t most) {
  require_points(points);
  require_length(range, "range");
  require_length(voxel_size, "voxel_size");
  require_length(radius, "radius");
  require_length(thickness, "thickness");
  std::vector<float> normals;
  {
    nb::gil_scoped_release release;
    require_usable(points.data(), points.size(), "points");
    normals = flat_normals(points.data(), points.shape(0),
                           {range, voxel_size, {radius, min_points, thickness, most}});
  }
  const std::size_t count = normals.size() / 3;
  return to_numpy(std::move(normals), {count, 3});
}

Out<double> fit_vertical_(const In2<float>& normals, const In2<double>& directions,
                          const std::vector<double>& tolerances) {
  require_points(normals, "normals");
  require(directions.shape(1) == 3 && directions.shape(0) > 0, "directions must have shape (D, 3)");
  require_usable(normals.data(), normals.size(), "normals");
  require_usable(directions.data(), directions.size(), "directions");
  require_usable(tolerances.data(), tolerances.size(), "tolerances");
  std::array<double, 3> up;
  {
    nb::gil_scoped_release release;
    up = fit_vertical(normals.data(), normals.shape(0), directions.data(), directions.shape(0),
                      tolerances);
  }
  return to_numpy(std::vector<double>(up.begin(), up.end()));
}

double point_spacing_(const In2<float>& points, double least, std::size_t most) {
  require_points(points);
  require_length(least, "least");
  nb::gil_scoped_release release;
  require_usable(points.data(), points.size(), "points");
  return point_spacing(points.data(), points.shape(0), least, most);
}

auto cast_(const MeshRays& mesh, const In2<float>& origins, const In2<float>& directions,
           double max_range, int threads) {
  require_points(origins, "origins");
  require_points(directions, "directions");
  const std::size_t rays = origins.shape(0);
  require(directions.shape(0) == rays, "origins and directions differ in length");
  require_length(max_range, "max_range");
  std::vector<float> ranges(rays);
  std::vector<std::int32_t> triangles(rays);
  {
    nb::gil_scoped_release release;
    require_usable(origins.data(), origins.size(), "origins");
    require_usable(directions.data(), directions.size(), "directions");
    std::vector<RayHit> hits(rays);
    mesh.cast(origins.data(), directions.data(), rays, static_cast<float>(max_range), threads,
              hits.data());
    for (std::size_t i = 0; i < rays; ++i) {
      ranges[i] = hits[i].range;
      triangles[i] = hits[i].triangle;
    }
  }
  return std::make_tuple(to_numpy(std::move(ranges)), to_numpy(std::move(triangles)));
}

}  // namespace

void bind_segmentation(nb::module_& m) {
  m.def("central_points", &central_points_, nb::arg("points").noconvert(),
        nb::arg("origin").noconvert(), nb::arg("voxel"));
  m.def("voxel_grid", &voxel_grid_, nb::arg("points").noconvert(), nb::arg("size"));
  m.def("heights_above_ground", &heights_above_ground_, nb::arg("points").noconvert(),
        nb::arg("cell"), nb::arg("max_slope"), nb::arg("outlier"));
  m.def("euclidean_clusters", &euclidean_clusters_, nb::arg("points").noconvert(),
        nb::arg("radius"), nb::arg("min_points"), nb::arg("max_points"));
  m.def("split_by_height", &split_by_height_, nb::arg("points").noconvert(),
        nb::arg("heights").noconvert(), nb::arg("cut"));
  m.def("segments_above", &segments_above_, nb::arg("points").noconvert(),
        nb::arg("heights").noconvert(), nb::arg("cuts"), nb::arg("radius"), nb::arg("min_points"),
        nb::arg("max_points"));
  m.def("flat_normals", &flat_normals_, nb::arg("points").noconvert(), nb::arg("range"),
        nb::arg("voxel_size"), nb::arg("radius"), nb::arg("min_points"), nb::arg("thickness"),
        nb::arg("most"));
  m.def("fit_vertical", &fit_vertical_, nb::arg("normals").noconvert(),
        nb::arg("directions").noconvert(), nb::arg("tolerances"));
  m.def("point_spacing", &point_spacing_, nb::arg("points").noconvert(), nb::arg("least"),
        nb::arg("most"));
  nb::class_<MeshRays>(m, "MeshRays")
      .def(
          "__init__",
          [](MeshRays* self, const In3<float>& triangles) {
            require(triangles.shape(1) == 3 && triangles.shape(2) == 3,
                    "triangles must have shape (N, 3, 3)");
            require(triangles.shape(0) <= std::numeric_limits<std::int32_t>::max(),
                    "triangles has too many rows");
            nb::gil_scoped_release release;
            require_usable(triangles.data(), triangles.size(), "triangles");
            new (self) MeshRays(triangles.data(), triangles.shape(0));
          },
          nb::arg("triangles").noconvert())
      .def("__len__", &MeshRays::size)
      .def("cast", &cast_, nb::arg("origins").noconvert(), nb::arg("directions").noconvert(),
           nb::arg("max_range"), nb::arg("threads") = 0);
}

}  // namespace segloc::bindings
