#include "descriptors/align.h"

#include <algorithm>
#include <cmath>
#include <limits>

#include "descriptors/moments.h"

namespace segloc {
namespace {

void rotate(std::vector<float>& p, std::size_t n, const Mat3& R) {
  for (std::size_t i = 0; i < n; ++i) {
    float* q = p.data() + 3 * i;
    const double x = q[0], y = q[1], z = q[2];
    for (std::size_t d = 0; d < 3; ++d) {
      q[d] = static_cast<float>(R[d][0] * x + R[d][1] * y + R[d][2] * z);
    }
  }
}

// SegMap's rule: at least half of the points lie below the middle of the range.
bool lower_half_is_sparse(const std::vector<float>& p, std::size_t n, std::size_t axis) {
  float low = std::numeric_limits<float>::max(), high = -low;
  for (std::size_t i = 0; i < n; ++i) {
    low = std::min(low, p[3 * i + axis]);
    high = std::max(high, p[3 * i + axis]);
  }
  const double middle = (double{low} + double{high}) / 2;
  std::size_t below = 0;
  for (std::size_t i = 0; i < n; ++i) below += p[3 * i + axis] < middle;
  return 2 * below < n;
}

void flip(std::vector<float>& p, std::size_t n, std::size_t a, std::size_t b) {
  for (std::size_t i = 0; i < n; ++i) {
    p[3 * i + a] = -p[3 * i + a];
    p[3 * i + b] = -p[3 * i + b];
  }
}

}  // namespace

void align_2d(std::vector<float>& p, std::size_t n) {
  const double angle = major_angle(covariance_of(p.data(), n));
  const double cs = std::cos(angle), sn = std::sin(angle);
  rotate(p, n, {{{cs, sn, 0}, {-sn, cs, 0}, {0, 0, 1}}});
  if (lower_half_is_sparse(p, n, 1)) flip(p, n, 0, 1);
}

void align_3d(std::vector<float>& p, std::size_t n) {
  Mat3 axes = eigen_axes(covariance_of(p.data(), n)).axes;
  const auto& [x, y, z] = axes;
  const double volume = x[0] * (y[1] * z[2] - y[2] * z[1]) - x[1] * (y[0] * z[2] - y[2] * z[0]) +
                        x[2] * (y[0] * z[1] - y[1] * z[0]);
  if (volume < 0) axes[2] = {-z[0], -z[1], -z[2]};
  rotate(p, n, axes);
  if (lower_half_is_sparse(p, n, 0)) flip(p, n, 0, 2);
  if (lower_half_is_sparse(p, n, 1)) flip(p, n, 1, 2);
}

}  // namespace segloc
