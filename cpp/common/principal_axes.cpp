#include "common/principal_axes.h"

#include <algorithm>
#include <cmath>

#include "common/angles.h"

namespace segloc {

Symmetric covariance(const PointSums& sums) {
  const double n = static_cast<double>(sums.count);
  const double x = sums.first[0] / n, y = sums.first[1] / n, z = sums.first[2] / n;
  const double* second = sums.second;
  return {second[0] / n - x * x, second[1] / n - x * y, second[2] / n - x * z,
          second[3] / n - y * y, second[4] / n - y * z, second[5] / n - z * z};
}

// Eigenvalues by the closed form of Smith (CACM, 1961).
PrincipalAxes principal_axes(const Symmetric& c) {
  PrincipalAxes axes;
  const double mean = (c[0] + c[3] + c[5]) / 3.0;
  axes.least = axes.middle = axes.most = mean;
  const double x = c[0] - mean, y = c[3] - mean, z = c[5] - mean;
  const double off = c[1] * c[1] + c[2] * c[2] + c[4] * c[4];
  const double p = std::sqrt((x * x + y * y + z * z + 2.0 * off) / 6.0);
  if (!(p > 1e-9 * mean)) return axes;
  const double det =
      x * (y * z - c[4] * c[4]) - c[1] * (c[1] * z - c[4] * c[2]) + c[2] * (c[1] * c[4] - y * c[2]);
  const double angle = std::acos(std::clamp(det / (2.0 * p * p * p), -1.0, 1.0)) / 3.0;
  const double least = 2.0 * p * std::cos(angle + 2.0 * kPi / 3.0);
  const double most = 2.0 * p * std::cos(angle);
  axes.least = mean + least, axes.middle = mean - least - most, axes.most = mean + most;
  // Rows of (matrix - least) are normal to the axis: the longest product of two of them is it.
  const double rows[3][3] = {
      {x - least, c[1], c[2]}, {c[1], y - least, c[4]}, {c[2], c[4], z - least}};
  std::array<double, 3> best = {0, 0, 0};
  double longest = 0.0;
  for (int i = 0; i < 3; ++i) {
    const double *a = rows[i], *b = rows[(i + 1) % 3];
    const std::array<double, 3> n = {a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2],
                                     a[0] * b[1] - a[1] * b[0]};
    const double squared = n[0] * n[0] + n[1] * n[1] + n[2] * n[2];
    if (squared > longest) longest = squared, best = n;
  }
  if (!(longest > 1e-12 * p * p * p * p)) return axes;
  for (double& v : best) v /= std::sqrt(longest);
  axes.least_axis = best;
  return axes;
}

}  // namespace segloc
