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
  const std::size_t sampled = std::min(n, options.most);
  std::vector<float> places, normals;
  for (std::size_t k = 0; k < sampled; ++k) {
    const PointGrid::Point p = grid[k * n / sampled];
    places.insert(places.end(), p.begin(), p.end());
  }
  std::vector<PointSums> around(sampled);
  grid.sums_within(places.data(), sampled, far / 4, around.data());
  for (std::size_t k = 0; k < sampled; ++k) {
    PointSums& sums = around[k];
    if (sums.count < options.min_points) grid.sums_within(&places[3 * k], 1, far, &sums);
    if (sums.count < options.min_points) continue;
    const PrincipalAxes axes = principal_axes(covariance(sums));
    if (!is_flat(axes, options.thickness)) continue;
    for (const double v : axes.least_axis) normals.push_back(static_cast<float>(v));
  }
  return normals;
}

}  // namespace segloc
