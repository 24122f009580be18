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

float squared_distance(const PointGrid::Point& a, const PointGrid::Point& b) {
  const float dx = a[0] - b[0], dy = a[1] - b[1], dz = a[2] - b[2];
  return dx * dx + dy * dy + dz * dz;
}

}  // namespace

std::vector<float> plane_normals(const float* points, std::size_t n, const PlaneOptions& options) {
  const PointGrid grid(points, n, options.radius);
  const auto far = static_cast<float>(options.radius * options.radius);
  const float near = far / 4;
  const std::size_t sampled = std::min(n, options.most);
  const std::unique_ptr<std::uint32_t[]> around(new std::uint32_t[2 * (n + PointGrid::kPad)]);
  std::uint32_t* close = around.get() + n + PointGrid::kPad;
  std::vector<float> normals;
  for (std::size_t k = 0; k < sampled; ++k) {
    const PointGrid::Point p = grid[k * n / sampled];
    const std::size_t count = grid.within(p, options.radius, far, around.get());
    if (count < options.min_points) continue;
    std::size_t close_count = 0;
    for (std::size_t j = 0; j < count; ++j) {  // no branch to guess
      close[close_count] = around[j];
      close_count += squared_distance(grid[around[j]], p) <= near;
    }
    const bool dense = close_count >= options.min_points;
    const std::uint32_t* used = dense ? close : around.get();
    Moments moments;
    for (std::size_t j = 0; j < (dense ? close_count : count); ++j) moments.add(grid[used[j]], p);
    const PrincipalAxes axes = principal_axes(moments.covariance());
    if (!is_flat(axes, options.thickness)) continue;
    for (const double v : axes.least_axis) normals.push_back(static_cast<float>(v));
  }
  return normals;
}

}  // namespace segloc
