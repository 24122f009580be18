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

}  // namespace

std::vector<float> plane_normals(const float* points, std::size_t n, const PlaneOptions& options) {
  const PointGrid grid(points, n, options.radius);
  const auto far = static_cast<float>(options.radius * options.radius);
  const float near = far / 4;
  const std::size_t judged = std::min(n, options.most);
  std::vector<float> normals;
  for (std::size_t k = 0; k < judged; ++k) {
    const PointGrid::Point p = grid[k * n / judged];
    Moments close, around;
    grid.visit(p, options.radius, [&](std::uint32_t i, float squared) {
      if (squared <= far) around.add(grid[i], p);
      if (squared <= near) close.add(grid[i], p);
    });
    if (around.count() < options.min_points) continue;
    const bool dense = close.count() >= options.min_points;
    const PrincipalAxes axes = principal_axes((dense ? close : around).covariance());
    if (!is_flat(axes, options.thickness)) continue;
    for (const double v : axes.least_axis) normals.push_back(static_cast<float>(v));
  }
  return normals;
}

}  // namespace segloc
