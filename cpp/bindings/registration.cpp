// Registration: surfaces and generalised ICP.
#include <algorithm>
#include <numeric>

#include "bindings/bindings.h"
#include "bindings/rigid.h"
#include "likelihood/gicp.h"
#include "likelihood/surface.h"

namespace segloc::bindings {
namespace {

Out<double> matrix_of(const Rigid& T) {
  std::vector<double> values;
  append_matrix(T, values);
  return to_numpy(std::move(values), {4, 4});
}

auto align_(const Surface& target, const Surface& source, const In2<double>& T_target_source,
            int max_iterations, int threads, int max_final) {
  const Rigid start = rigid_of(T_target_source, "T_target_source");
  require_between(max_iterations, 0, 10'000, "max_iterations");
  require_between(max_final, 0, 10'000, "max_final");
  GicpOptions options;
  options.max_iterations = max_iterations, options.max_final = max_final;
  GicpResult result;
  {
    nb::gil_scoped_release release;
    result = align(target, source, start, options, threads);
  }
  const auto square = [](const std::array<double, 36>& values) {
    return to_numpy(std::vector<double>(values.begin(), values.end()), {6, 6});
  };
  return std::make_tuple(matrix_of(result.T), square(result.H), square(result.motion), result.error,
                         result.inliers, result.iterations);
}

void require_surface(const In2<float>& points, double max_correspondence_distance,
                     double support) {
  require_points(points);
  require_usable(points.data(), points.size(), "points");
  require_length(max_correspondence_distance, "max_correspondence_distance");
  require_length(support, "support");
}

// Normals of a surface in the order of its points.
auto normals_(const In2<float>& points, double max_correspondence_distance, double support) {
  require_surface(points, max_correspondence_distance, support);
  const std::size_t n = points.shape(0);
  std::vector<double> values(3 * n);
  {
    nb::gil_scoped_release release;
    std::vector<std::uint32_t> rows;
    const Surface surface(points.data(), n, max_correspondence_distance, support, false, &rows);
    std::vector<std::uint32_t> all(n);
    std::iota(all.begin(), all.end(), std::uint32_t{0});
    const std::vector<Surface::Normal> normals = surface.normals(all);
    for (std::size_t i = 0; i < n; ++i) {
      std::copy(normals[i].begin(), normals[i].end(), values.begin() + std::ptrdiff_t(3 * rows[i]));
    }
  }
  return to_numpy(std::move(values), {n, 3});
}

std::size_t step_of(const Surface& surface, std::size_t most) {
  require(most > 0, "most must be positive");
  return std::max<std::size_t>(1, (surface.size() + most - 1) / most);
}

// At most `most` points, evenly spread.
auto sampled_(const Surface& surface, std::size_t most) {
  std::vector<float> points;
  for (const std::uint32_t i : every(surface, step_of(surface, most))) {
    const PointGrid::Point p = surface.grid()[i];
    points.insert(points.end(), p.begin(), p.end());
  }
  const std::size_t rows = points.size() / 3;
  return to_numpy(std::move(points), {rows, 3});
}

// Normals of the points of `sampled`.
auto sampled_normals_(const Surface& surface, std::size_t most) {
  std::vector<double> values;
  const std::vector<std::uint32_t> sampled = every(surface, step_of(surface, most));
  {
    nb::gil_scoped_release release;
    for (const Surface::Normal& n : surface.normals(sampled)) {
      values.insert(values.end(), n.begin(), n.end());
    }
  }
  return to_numpy(std::move(values), {sampled.size(), 3});
}

// Distances of the points of `sampled`.
auto off_plane_(const Surface& target, const Surface& source, const In2<double>& T_target_source,
                double least_slope, double most_slope, std::size_t most) {
  const Rigid T = rigid_of(T_target_source, "T_target_source");
  const std::size_t step = step_of(source, most);
  std::vector<float> distances;
  {
    nb::gil_scoped_release release;
    distances = off_plane(target, source, T, step, {least_slope, most_slope});
  }
  return to_numpy(std::move(distances));
}

}  // namespace

void bind_registration(nb::module_& m) {
  m.def("normals", &normals_, nb::arg("points").noconvert(),
        nb::arg("max_correspondence_distance"), nb::arg("support"));
  nb::class_<Surface>(m, "Surface")
      .def(
          "__init__",
          [](Surface* self, const In2<float>& points, double max_correspondence_distance,
             double support, bool tiled) {
            require_surface(points, max_correspondence_distance, support);
            nb::gil_scoped_release release;
            new (self) Surface(points.data(), points.shape(0), max_correspondence_distance, support,
                               tiled);
          },
          nb::arg("points").noconvert(), nb::arg("max_correspondence_distance"), nb::arg("support"),
          nb::arg("tiled") = false)
      .def("__len__", &Surface::size)
      .def("sampled", &sampled_, nb::arg("most"))
      .def("sampled_normals", &sampled_normals_, nb::arg("most"))
      .def("off_plane", &off_plane_, nb::arg("source"), nb::arg("T_target_source").noconvert(),
           nb::arg("least_slope"), nb::arg("most_slope"), nb::arg("most"))
      .def("align", &align_, nb::arg("source"), nb::arg("T_target_source").noconvert(),
           nb::arg("max_iterations") = 20, nb::arg("threads") = 0, nb::arg("max_final") = 6);
}

}  // namespace segloc::bindings
