// Verification: overlap and visibility.
#include "bindings/bindings.h"
#include "verification/point_index.h"
#include "verification/visibility.h"

namespace segloc::bindings {
namespace {

auto overlap_(const PointIndex& index, const In2<float>& points, const In3<double>& poses,
              double radius) {
  require_points(points);
  require(poses.shape(1) == 4 && poses.shape(2) == 4, "poses must have shape (H, 4, 4)");
  require(radius > 0 && radius <= index.radius(),
          "radius must be positive and at most the index's");
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

auto count_visible(const VisibilityCheck& check, const In2<float>& map,
                   const In2<double>& T_query_map, double radius, double margin) {
  require_points(map);
  require(T_query_map.shape(0) == 4 && T_query_map.shape(1) == 4,
          "T_local_site must have shape (4, 4)");
  require(radius > 0 && radius <= check.radius(), "radius must be positive and at most the view's");
  require(margin >= 0, "margin must not be negative");
  nb::gil_scoped_release release;
  const VisibilityCheck::Counts counts =
      check.count(map.data(), map.shape(0), T_query_map.data(), radius, margin);
  return std::make_tuple(counts.confirmed, counts.violations);
}

}  // namespace

void bind_verification(nb::module_& m) {
  nb::class_<VisibilityCheck>(m, "Sight")
      .def(
          "__init__",
          [](VisibilityCheck* self, const In2<float>& structure, const In2<float>& ground,
             double range, double bin_deg, double radius) {
            require_points(structure);
            require_points(ground);
            require_usable(structure.data(), structure.size(), "structure");
            require_usable(ground.data(), ground.size(), "ground");
            require(range > 0 && range <= 1000 && radius > 0, "range and radius must be positive");
            require(bin_deg >= 0.1 && bin_deg <= 10, "bin_deg must be between 0.1 and 10");
            new (self) VisibilityCheck(structure.data(), structure.shape(0), ground.data(),
                                       ground.shape(0), range, bin_deg, radius);
          },
          nb::arg("structure").noconvert(), nb::arg("ground").noconvert(), nb::arg("range"),
          nb::arg("bin_deg"), nb::arg("radius"))
      .def("look", &count_visible, nb::arg("site").noconvert(), nb::arg("T_local_site").noconvert(),
           nb::arg("radius"), nb::arg("margin"));

  nb::class_<PointIndex>(m, "PointIndex")
      .def(
          "__init__",
          [](PointIndex* self, const In2<float>& points, double radius) {
            require_points(points);
            require_usable(points.data(), points.size(), "points");
            new (self) PointIndex(points.data(), points.shape(0), radius);
          },
          nb::arg("points").noconvert(), nb::arg("radius"))
      .def("__len__", &PointIndex::size)
      .def("overlap", &overlap_, nb::arg("points").noconvert(), nb::arg("poses").noconvert(),
           nb::arg("radius"))
      .def(
          "sample",
          [](const PointIndex& index, double x, double y, double radius, std::size_t count) {
            require(count > 0, "count must be positive");
            std::vector<float> points = index.sample(x, y, radius, count);
            const std::size_t rows = points.size() / 3;
            return to_numpy(std::move(points), {rows, 3});
          },
          nb::arg("x"), nb::arg("y"), nb::arg("radius"), nb::arg("count"));
}

}  // namespace segloc::bindings
