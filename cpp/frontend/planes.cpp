#include "frontend/planes.h"

#include <algorithm>

#include "common/principal_axes.h"
#include "frontend/point_grid.h"

namespace segloc {
namespace {

constexpr double kFlat = 0.04;   // the least variance is at most this share of the middle one
constexpr double kBroad = 0.05;  // and the middle one at least this of the greatest: not a line

bool is_flat(const PrincipalAxes& axes, double thickness) {
  return axes.least < thickness * thickness && axes.least < kFlat * axes.middle &&
         axes.middle > kBroad * axes.most;
}

float squared_distance(const PointGrid::Point& a, const PointGrid::Point& b) {
  const float dx = a[0] - b[0], dy = a[1] - b[1], dz = a[2] - b[2];
  return dx * dx + dy * dy + dz * dz;
}

}  // namespace

std::vector<float> plane_normals(const float* points, std::size_t n, const PlaneOptions& options) {
  const PointGrid grid(points, n, options.radius);
  const auto far = static_cast<float>(options.radius * options.radius);
  const float near = far / 4;
  const std::size_t judged = std::min(n, options.most);
  std::vector<float> normals;
  std::vector<std::uint32_t> around, close;
  for (std::size_t k = 0; k < judged; ++k) {
    const PointGrid::Point p = grid[k * n / judged];
    around.clear();
    grid.within(p, options.radius, far, around);
    if (around.size() < options.min_points) continue;
    close.clear();
    for (const std::uint32_t i : around) {
      if (squared_distance(grid[i], p) <= near) close.push_back(i);
    }
    Moments moments;
    for (const std::uint32_t i : close.size() >= options.min_points ? close : around) {
      moments.add(grid[i], p);
    }
    const PrincipalAxes axes = principal_axes(moments.covariance());
    if (!is_flat(axes, options.thickness)) continue;
    for (const double v : axes.least_axis) normals.push_back(static_cast<float>(v));
  }
  return normals;
}

}  // namespace segloc
