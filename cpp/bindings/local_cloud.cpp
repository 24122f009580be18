// Local clouds: the scans of a window on one lattice.
#include <mutex>

#include "bindings/bindings.h"
#include "bindings/rigid.h"
#include "frontend/crop.h"
#include "frontend/voxel_window.h"

namespace segloc::bindings {
namespace {

// Thread-safe: calls take turns.
struct BoundWindow {
  BoundWindow(double voxel_size, double reach) : window(voxel_size, reach) {}

  VoxelWindow window;
  std::mutex turn;
};

void push_(BoundWindow& self, const In2<float>& points, const In2<double>& T_odom_sensor) {
  require_points(points);
  const Rigid T = rigid_of(T_odom_sensor, "T_odom_sensor");
  nb::gil_scoped_release release;
  require_usable(points.data(), points.size(), "points");
  const std::lock_guard<std::mutex> lock(self.turn);
  self.window.push(points.data(), points.shape(0), T);
}

void drop_(BoundWindow& self, std::size_t position) {
  nb::gil_scoped_release release;
  const std::lock_guard<std::mutex> lock(self.turn);
  self.window.drop(position);
}

void move_(BoundWindow& self, const In3<double>& T_odom_sensor) {
  const std::vector<Rigid> poses = rigids_of(T_odom_sensor, "T_odom_sensor");
  nb::gil_scoped_release release;
  const std::lock_guard<std::mutex> lock(self.turn);
  self.window.move(poses);
}

Out<float> cloud_(BoundWindow& self, const In2<double>& T_local_odom, double radius) {
  const Rigid T = rigid_of(T_local_odom, "T_local_odom");
  require_length(radius, "radius");
  std::vector<float> points;
  {
    nb::gil_scoped_release release;
    const std::lock_guard<std::mutex> lock(self.turn);
    points = self.window.cloud(T, radius);
  }
  const std::size_t count = points.size() / 3;
  return to_numpy(std::move(points), {count, 3});
}

Out<float> moved_crop_(const In2<float>& points, const In2<double>& T, double radius) {
  require_points(points);
  const Rigid moved = rigid_of(T, "T");
  require_length(radius, "radius");
  std::vector<float> kept;
  {
    nb::gil_scoped_release release;
    require_usable(points.data(), points.size(), "points");
    kept = moved_crop(points.data(), points.shape(0), moved, radius);
  }
  const std::size_t count = kept.size() / 3;
  return to_numpy(std::move(kept), {count, 3});
}

// A number read under the lock.
template <std::size_t (VoxelWindow::*Number)() const>
std::size_t number_(BoundWindow& self) {
  nb::gil_scoped_release release;
  const std::lock_guard<std::mutex> lock(self.turn);
  return (self.window.*Number)();
}

}  // namespace

void bind_local_cloud(nb::module_& m) {
  m.def("moved_crop", &moved_crop_, nb::arg("points").noconvert(), nb::arg("T").noconvert(),
        nb::arg("radius"));
  nb::class_<BoundWindow>(m, "VoxelWindow")
      .def(
          "__init__",
          [](BoundWindow* self, double voxel_size, double reach) {
            require_length(voxel_size, "voxel_size");
            require_length(reach, "reach");
            new (self) BoundWindow(voxel_size, reach);
          },
          nb::arg("voxel_size"), nb::arg("reach"))
      .def("__len__", &number_<&VoxelWindow::scans>)
      .def_prop_ro("voxels", &number_<&VoxelWindow::voxels>)
      .def_prop_ro("nbytes", &number_<&VoxelWindow::nbytes>)
      .def("push", &push_, nb::arg("points").noconvert(), nb::arg("T_odom_sensor").noconvert())
      .def("drop", &drop_, nb::arg("position"))
      .def("move", &move_, nb::arg("T_odom_sensor").noconvert())
      .def("cloud", &cloud_, nb::arg("T_local_odom").noconvert(), nb::arg("radius"));
}

}  // namespace segloc::bindings
