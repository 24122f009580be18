#include "frontend/gravity.h"

#include <algorithm>
#include <cmath>
#include <memory>

#include "common/angles.h"
#include "common/cells.h"
#include "common/eigen_axes.h"
#include "simd/kernels.h"

namespace segloc {
namespace {

// From the air the nearest points may all be roofs: the range is at least kFar times the median
// range, but at most kFarthest times the usual one.
constexpr double kFar = 1.5, kFarthest = 3.0;
constexpr double kStart = 8.0 * kPi / 180.0;  // agreement ends there, radians
constexpr std::size_t kLanes = 16;

float squared_range(const float* p) { return p[0] * p[0] + p[1] * p[1] + p[2] * p[2]; }

// The median of n > 0 squared ranges.
double median_squared_range(const float* points, std::size_t n) {
  std::vector<float> squares(n);
  for (std::size_t i = 0; i < n; ++i) squares[i] = squared_range(points + 3 * i);
  const auto middle = squares.begin() + static_cast<std::ptrdiff_t>(n / 2);
  std::nth_element(squares.begin(), middle, squares.end());
  if (n % 2 != 0) return *middle;
  return (*std::max_element(squares.begin(), middle) + *middle) / 2.0f;
}

// Writes the points nearer than `limit`, squared, and returns how many values; counts those beyond
// `far`, squared.
std::size_t pack_near(const float* points, std::size_t n, double limit, double far, float* near,
                      std::size_t& beyond) {
  const auto most = static_cast<float>(limit), counted = static_cast<float>(far);
  std::size_t size = 0, count = 0;
  for (std::size_t i = 0; i < n; ++i) {  // no branch to guess
    const float* p = points + 3 * i;
    const float squared = squared_range(p);
    for (std::size_t a = 0; a < 3; ++a) near[size + a] = p[a];
    size += squared < most ? 3 : 0;
    count += squared > counted;
  }
  beyond = count;
  return size;
}

// The voxel grid of the points within range.
std::vector<float> thinned_near(const float* points, std::size_t n, const FlatOptions& options) {
  const double usual = options.range * options.range, far = usual / (kFar * kFar);
  double limit = usual;
  const std::unique_ptr<float[]> near(new float[3 * n + 3]);
  std::size_t beyond = 0, size = pack_near(points, n, limit, far, near.get(), beyond);
  if (n > 0 && 2 * beyond >= n) {
    const double wide = kFar * kFar * median_squared_range(points, n);
    limit = std::max(usual, std::min(wide, kFarthest * kFarthest * usual));
    size = pack_near(points, n, limit, far, near.get(), beyond);
  }
  return voxel_grid(near.get(), size / 3, options.voxel_size);
}

// Of the directions, the first that most normals agree with.
std::size_t best_direction(const float* normals, std::size_t n, const double* directions,
                           std::size_t count) {
  const std::size_t stride = padded(n, kLanes);
  std::vector<float> xyz(3 * stride, 0.0f);  // zeros count the same for all directions
  for (std::size_t i = 0; i < n; ++i) {
    for (std::size_t a = 0; a < 3; ++a) xyz[a * stride + i] = normals[3 * i + a];
  }
  const PointArrays arrays = {xyz.data(), xyz.data() + stride, xyz.data() + 2 * stride};
  const double sine = std::sin(kStart);
  std::vector<double> scores(count);
  best_kernels().agreements(arrays, stride, directions, count,
                            static_cast<float>(1.0 / (sine * sine)), scores.data());
  return static_cast<std::size_t>(std::max_element(scores.begin(), scores.end()) -
                                  scores.begin());
}

// Adds a squared sine as a quadratic form of the direction: of the angle between it and the normal
// of a floor, or between it and the plane of a wall.
void add_squared_sine(Mat3& sums, const float* normal, bool floor) {
  for (std::size_t a = 0; a < 3; ++a) {
    for (std::size_t b = 0; b < 3; ++b) {
      const double product = double{normal[a]} * normal[b];
      sums[a][b] += floor ? double(a == b) - product : product;
    }
  }
}

}  // namespace

std::vector<float> flat_normals(const float* points, std::size_t n, const FlatOptions& options) {
  const std::vector<float> thinned = thinned_near(points, n, options);
  return plane_normals(thinned.data(), thinned.size() / 3, options.planes);
}

std::array<double, 3> fit_vertical(const float* normals, std::size_t n, const double* directions,
                                   std::size_t count, const std::vector<double>& tolerances) {
  const double* start = directions + 3 * best_direction(normals, n, directions, count);
  Vec3 up = {start[0], start[1], start[2]};
  for (const double tolerance : tolerances) {
    const double floor = std::cos(tolerance), wall = std::sin(tolerance);
    Mat3 sums = {};
    for (const float* p = normals; p < normals + 3 * n; p += 3) {
      const double along = std::abs(p[0] * up[0] + p[1] * up[1] + p[2] * up[2]);
      if (along > floor || along < wall) add_squared_sine(sums, p, along > floor);
    }
    const Vec3 axis = eigen_axes(sums).axes[2];
    const double sign = axis[0] * up[0] + axis[1] * up[1] + axis[2] * up[2] > 0.0 ? 1.0 : -1.0;
    for (std::size_t a = 0; a < 3; ++a) up[a] = sign * axis[a];
  }
  return up;
}

}  // namespace segloc
