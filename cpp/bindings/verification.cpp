// Verification: overlap and visibility.
#include <limits>

#include "bindings/bindings.h"
#include "likelihood/correlation.h"
#include "likelihood/known_space.h"
#include "likelihood/point_index.h"
#include "likelihood/visibility.h"

namespace segloc::bindings {
namespace {

// A point in unmapped space counts `unmapped` of a point with a neighbour.
double share_of(const PointIndex::Overlap& found, double unmapped) {
  const double known = double(found.near) + unmapped * double(found.unmapped);
  const std::size_t all = found.compared + found.unmapped;
  return all == 0 ? 0.0 : known / double(all);
}

void require_overlap(const PointIndex& index, const In2<float>& points, double radius,
                     double unmapped) {
  require_points(points);
  require_between(radius, kShortest, index.radius(), "radius");
  require_between(unmapped, 0.0, 1.0, "unmapped");
}

auto overlap_(const PointIndex& index, const In2<float>& points, const In3<double>& poses,
              double radius, double unmapped) {
  require_overlap(index, points, radius, unmapped);
  require(poses.shape(1) == 4 && poses.shape(2) == 4, "poses must have shape (H, 4, 4)");
  require_usable(poses.data(), poses.size(), "poses");
  std::vector<double> share(poses.shape(0));
  {
    nb::gil_scoped_release release;
    const std::size_t m = points.shape(0);
    require_usable(points.data(), points.size(), "points");
    for (std::size_t h = 0; h < share.size(); ++h) {
      const double* T = poses.data() + 16 * h;
      share[h] = share_of(index.overlap(points.data(), m, T, radius, false), unmapped);
    }
  }
  return to_numpy(std::move(share));
}

auto overlap_rmse(const PointIndex& index, const In2<float>& points, const In2<double>& T_map_local,
                  double radius, double unmapped) {
  require_overlap(index, points, radius, unmapped);
  require_transform(T_map_local, "T_map_local");
  nb::gil_scoped_release release;
  require_usable(points.data(), points.size(), "points");
  const auto found =
      index.overlap(points.data(), points.shape(0), T_map_local.data(), radius, true);
  // NaN where nothing is near.
  return std::make_tuple(share_of(found, unmapped),
                         std::sqrt(found.squared_sum / double(found.near)));
}

auto correlate_(const PointIndex& index, const In2<float>& points, const In2<double>& T_map_local,
                const std::vector<double>& headings, double cell, double half_width, double range) {
  require_points(points);
  require_transform(T_map_local, "T_map_local");
  require(!headings.empty() && headings.size() <= 360, "headings must be 1 to 360");
  require_usable(headings.data(), headings.size(), "headings");
  require_between(cell, 0.05, 10.0, "cell");
  require_between(half_width, 0.0, 100.0 * cell, "half_width");
  require_between(range, cell, 400.0 * cell, "range");
  Correlation found;
  {
    nb::gil_scoped_release release;
    require_usable(points.data(), points.size(), "points");
    CorrelationOptions options;
    options.cell = cell, options.half_width = half_width, options.range = range;
    found = correlate(index, points.data(), points.shape(0), T_map_local.data(), headings, options);
  }
  const std::size_t width = found.width;
  return std::make_tuple(to_numpy(std::move(found.counts), {headings.size(), width, width}),
                         to_numpy(std::move(found.used)));
}

auto codes_(const KnownSpace& known, const In2<float>& points, const In2<double>& T_map_local,
            double radius) {
  require_points(points);
  require_transform(T_map_local, "T_map_local");
  require_between(radius, kShortest, known.radius(), "radius");
  std::vector<std::uint8_t> codes;
  {
    nb::gil_scoped_release release;
    require_usable(points.data(), points.size(), "points");
    codes = known.codes(points.data(), points.shape(0), T_map_local.data(), radius);
  }
  return to_numpy(std::move(codes));
}

auto count_visible(const VisibilityCheck& check, const In2<float>& map,
                   const In2<double>& T_query_map, double radius, double margin) {
  require_points(map, "points");
  require_transform(T_query_map, "T_local_map");
  require_between(radius, kShortest, check.radius(), "radius");
  require_between(margin, 0.0, kLongest, "margin");
  nb::gil_scoped_release release;
  require_usable(map.data(), map.size(), "points");
  const VisibilityCheck::Counts counts =
      check.count(map.data(), map.shape(0), T_query_map.data(), radius, margin);
  return std::make_tuple(counts.confirmed, counts.violations);
}

}  // namespace

void bind_verification(nb::module_& m) {
  nb::class_<VisibilityCheck>(m, "VisibilityCheck")
      .def(
          "__init__",
          [](VisibilityCheck* self, const In2<float>& structure, const In2<float>& ground,
             double range, double bin_deg, double radius) {
            require_points(structure, "structure");
            require_points(ground, "ground");
            require_usable(structure.data(), structure.size(), "structure");
            require_usable(ground.data(), ground.size(), "ground");
            require_between(range, kShortest, 1000.0, "range");
            require_between(bin_deg, 0.1, 10.0, "bin_deg");
            require_length(radius, "radius");
            new (self) VisibilityCheck(structure.data(), structure.shape(0), ground.data(),
                                       ground.shape(0), range, bin_deg, radius);
          },
          nb::arg("structure").noconvert(), nb::arg("ground").noconvert(), nb::arg("range"),
          nb::arg("bin_deg"), nb::arg("radius"))
      .def("count", &count_visible, nb::arg("points").noconvert(),
           nb::arg("T_local_map").noconvert(), nb::arg("radius"), nb::arg("margin"));

  nb::class_<PointIndex>(m, "PointIndex")
      .def(
          "__init__",
          [](PointIndex* self, const In2<float>& points, double radius) {
            require_points(points);
            require_length(radius, "radius");
            require_usable(points.data(), points.size(), "points");
            new (self) PointIndex(points.data(), points.shape(0), radius);
          },
          nb::arg("points").noconvert(), nb::arg("radius"))
      .def("__len__", &PointIndex::size)
      .def("overlap", &overlap_, nb::arg("points").noconvert(), nb::arg("poses").noconvert(),
           nb::arg("radius"), nb::arg("unmapped") = 0.0)
      .def("overlap_rmse", &overlap_rmse, nb::arg("points").noconvert(),
           nb::arg("T_map_local").noconvert(), nb::arg("radius"), nb::arg("unmapped") = 0.0)
      .def("correlate", &correlate_, nb::arg("points").noconvert(),
           nb::arg("T_map_local").noconvert(), nb::arg("headings"), nb::arg("cell"),
           nb::arg("half_width"), nb::arg("range"))
      .def(
          "sample",
          [](const PointIndex& index, double x, double y, double radius, std::size_t count,
             double low, double high) {
            const double place[2] = {x, y};
            require_usable(place, 2, "x, y");
            require_between(radius, 0.0, kLongest, "radius");
            require(count > 0, "count must be positive");
            require(low <= high, "low must not be above high");
            std::vector<float> points = index.sample({x, y, radius, low, high}, count);
            const std::size_t rows = points.size() / 3;
            return to_numpy(std::move(points), {rows, 3});
          },
          nb::arg("x"), nb::arg("y"), nb::arg("radius"), nb::arg("count"),
          nb::arg("low") = -std::numeric_limits<double>::infinity(),
          nb::arg("high") = std::numeric_limits<double>::infinity());

  nb::class_<KnownSpace>(m, "KnownSpace")
      .def(
          "__init__",
          [](KnownSpace* self, const PointIndex& index, const In2<double>& viewpoints, double range,
             double bin_deg, double margin) {
            require(viewpoints.shape(1) == 3, "viewpoints must have shape (V, 3)");
            require_usable(viewpoints.data(), viewpoints.size(), "viewpoints");
            KnownSpaceOptions options;
            options.range = range, options.bin_deg = bin_deg, options.margin = margin;
            require_between(range, kShortest, 1000.0, "range");
            require_between(bin_deg, 0.1, 10.0, "bin_deg");
            require_between(margin, 0.0, kLongest, "margin");
            new (self) KnownSpace(index, viewpoints.data(), viewpoints.shape(0), options);
          },
          nb::arg("index"), nb::arg("viewpoints").noconvert(), nb::arg("range"),
          nb::arg("bin_deg"), nb::arg("margin"), nb::keep_alive<1, 2>())
      .def("codes", &codes_, nb::arg("points").noconvert(), nb::arg("T_map_local").noconvert(),
           nb::arg("radius"));
}

}  // namespace segloc::bindings
