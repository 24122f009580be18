#include "frontend/planes.h"

#include <algorithm>
#include <memory>

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
  const double close = options.radius / 2 * (1.0 + 1e-6);  // for rounding
  const std::size_t sampled = std::min(n, options.most);
  const std::unique_ptr<std::uint32_t[]> around(new std::uint32_t[n + PointGrid::kPad]);
  std::vector<float> normals;
  for (std::size_t k = 0; k < sampled; ++k) {
    const PointGrid::Point p = grid[k * n / sampled];
    std::size_t count = grid.within(p, close, far / 4, around.get());
    if (count < options.min_points) count = grid.within(p, options.radius, far, around.get());
    if (count < options.min_points) continue;
    Moments moments;
    for (std::size_t j = 0; j < count; ++j) moments.add(grid[around[j]], p);
    const PrincipalAxes axes = principal_axes(moments.covariance());
    if (!is_flat(axes, options.thickness)) continue;
    for (const double v : axes.least_axis) normals.push_back(static_cast<float>(v));
  }
  return normals;
}

}  // namespace segloc
