// Occupancy search of a query in a map.
#include <algorithm>
#include <cmath>
#include <functional>

#include "bindings/bindings.h"
#include "proposals/occupancy/occupancy_pyramid.h"
#include "proposals/occupancy/polar_images.h"
#include "proposals/occupancy/pose_search.h"

namespace segloc::bindings {
namespace {

// The occupancy of a map and the search area of the sensor.
class PoseSearch {
 public:
  PoseSearch(const float* points, const std::uint8_t* slices, std::size_t n, double cell,
             int levels, const std::int32_t* roots, std::size_t r, double range)
      : map_(points, slices, n, cell, levels), area_(map_, roots, r, range) {}
  PoseSearch(const PoseSearch&) = delete;
  PoseSearch& operator=(const PoseSearch&) = delete;

  const OccupancyPyramid& map() const { return map_; }
  const SearchArea& area() const { return area_; }

 private:
  OccupancyPyramid map_;
  SearchArea area_;
};

void construct(PoseSearch* self, const In2<float>& points, const In1<std::uint8_t>& slices,
               const In2<std::int32_t>& roots, double cell, int levels, double range) {
  require_points(points);
  require(slices.shape(0) == points.shape(0), "slices must have one value for each point");
  require(roots.shape(1) == 2, "roots must have shape (R, 2)");
  require_between(cell, 0.01, 100.0, "cell");
  require(levels >= 1 && levels <= 6, "levels must be from 1 to 6");
  require_between(range, 1.0, 200.0, "range");
  require(range / cell <= 10'000.0, "range must be at most 10000 cells");
  nb::gil_scoped_release release;
  require_usable(points.data(), points.size(), "points");
  for (std::size_t i = 0; i < roots.size(); ++i) {
    require_between(roots.data()[i], -(1 << 22), 1 << 22, "roots");
  }
  new (self) PoseSearch(points.data(), slices.data(), points.shape(0), cell, levels, roots.data(),
                        roots.shape(0), range);
}

bool within(const In2<float>& places, double range) {
  for (std::size_t i = 0; i < places.shape(0); ++i) {
    if (!(std::hypot(places.data()[2 * i], places.data()[2 * i + 1]) <= range)) return false;
  }
  return true;
}

auto search(const PoseSearch& self, const In2<float>& columns, const In1<std::uint8_t>& slices,
            const In2<float>& free, const In1<std::uint8_t>& clearance, std::size_t yaws,
            int leaf_level, std::size_t width, std::size_t count, double separation,
            double separation_deg, double x, double y, double radius) {
  require(columns.shape(1) == 2, "columns must have shape (M, 2)");
  require(slices.shape(0) == columns.shape(0), "slices must have one value for each column");
  require(columns.shape(0) <= 4096, "there are more than 4096 columns");
  require(free.shape(1) == 2, "free must have shape (F, 2)");
  require(clearance.shape(0) == free.shape(0), "clearance must have one value for each free place");
  require(free.shape(0) <= 4096, "there are more than 4096 free places");
  require(yaws >= 1 && yaws <= 1440, "yaws must be from 1 to 1440");
  require(leaf_level >= 0 && leaf_level < self.map().levels(), "leaf_level must be of the map's");
  require(width >= 1 && width <= 1'000'000, "width must be from 1 to 1000000");
  require(count <= 65536, "count must be at most 65536");
  require_between(separation, 0.0, kLongest, "separation");
  require_between(separation_deg, 0.0, 360.0, "separation_deg");
  require_between(x, -kLongest, kLongest, "x");
  require_between(y, -kLongest, kLongest, "y");
  require(radius >= 0.0, "radius must not be negative");
  std::vector<double> poses;
  std::vector<float> scores;
  {
    nb::gil_scoped_release release;
    require(within(columns, self.area().range()), "columns lie beyond the range");
    require(within(free, self.area().range()), "free places lie beyond the range");
    require(
        std::is_sorted(clearance.data(), clearance.data() + clearance.shape(0), std::greater<>()),
        "the clearest free places must come first");
    const SearchLimits limits{yaws,           leaf_level, width, count, separation,
                              separation_deg, x,          y,     radius};
    const PlanarView view{columns.data(), slices.data(),    columns.shape(0),
                          free.data(),    clearance.data(), free.shape(0)};
    for (const PlanarPose& p : self.area().search(view, limits)) {
      poses.insert(poses.end(), {p.x, p.y, p.yaw});
      scores.push_back(p.score);
    }
  }
  const std::size_t found = scores.size();
  return std::make_tuple(to_numpy(std::move(poses), {found, 3}), to_numpy(std::move(scores)));
}

auto polar_images_(const In2<float>& cells, const In1<std::uint8_t>& slices,
                   const In2<float>& places, double ring_m, int rings, int bands, int sectors,
                   int threads) {
  require(cells.shape(1) == 2, "cells must have shape (N, 2)");
  require(slices.shape(0) == cells.shape(0), "slices must have one value for each cell");
  require(places.shape(1) == 2, "places must have shape (P, 2)");
  require(places.shape(0) <= 1'000'000, "there are more than 1000000 places");
  require_between(ring_m, 0.01, 1000.0, "ring_m");
  require(rings >= 1 && rings <= 100, "rings must be from 1 to 100");
  require(bands == 1 || bands == 2 || bands == 4 || bands == 8, "bands must divide 8");
  require(sectors >= 2 && sectors <= 360 && sectors % 2 == 0,
          "sectors must be an even number from 2 to 360");
  std::vector<std::uint8_t> images;
  {
    nb::gil_scoped_release release;
    require_usable(cells.data(), cells.size(), "cells");
    require_usable(places.data(), places.size(), "places");
    images = polar_images(cells.data(), slices.data(), cells.shape(0), places.data(),
                          places.shape(0), {ring_m, rings, bands, sectors}, threads);
  }
  return to_numpy(std::move(images), {places.shape(0), std::size_t(rings), std::size_t(bands),
                                      std::size_t(sectors)});
}

}  // namespace

void bind_occupancy(nb::module_& m) {
  m.def("polar_images", &polar_images_, nb::arg("cells").noconvert(),
        nb::arg("slices").noconvert(), nb::arg("places").noconvert(), nb::arg("ring_m"),
        nb::arg("rings"), nb::arg("bands"), nb::arg("sectors"), nb::arg("threads") = 0);
  nb::class_<PoseSearch>(m, "PoseSearch")
      .def("__init__", &construct, nb::arg("points").noconvert(), nb::arg("slices").noconvert(),
           nb::arg("roots").noconvert(), nb::arg("cell"), nb::arg("levels"), nb::arg("range"))
      .def("search", &search, nb::arg("columns").noconvert(), nb::arg("slices").noconvert(),
           nb::arg("free").noconvert(), nb::arg("clearance").noconvert(), nb::arg("yaws"),
           nb::arg("leaf_level"), nb::arg("width"), nb::arg("count"), nb::arg("separation"),
           nb::arg("separation_deg"), nb::arg("x") = 0.0, nb::arg("y") = 0.0,
           nb::arg("radius") = std::numeric_limits<double>::infinity())
      .def_prop_ro("nbytes",
                   [](const PoseSearch& self) { return self.map().bytes() + self.area().bytes(); });
}

}  // namespace segloc::bindings
