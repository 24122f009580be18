#include "descriptors/moments.h"

#include <algorithm>
#include <cmath>

#include "common/parallel.h"

namespace segloc {

double fixed_point_scale(double largest, std::size_t n, int order) {
  int size_exponent = 0, count_exponent = 0;
  std::frexp(largest, &size_exponent);
  std::frexp(static_cast<double>(n), &count_exponent);
  return std::ldexp(1.0, (62 - count_exponent) / order - size_exponent - 1);
}

double largest_magnitude(const float* values, std::size_t count) {
  constexpr std::size_t kLanes = 16;  // becomes vector instructions
  float lanes[kLanes] = {};
  std::size_t i = 0;
  for (; i + kLanes <= count; i += kLanes) {
    for (std::size_t k = 0; k < kLanes; ++k) lanes[k] = std::max(lanes[k], std::abs(values[i + k]));
  }
  for (; i < count; ++i) lanes[0] = std::max(lanes[0], std::abs(values[i]));
  return *std::max_element(lanes, lanes + kLanes);
}

Vec3 mean_of(const float* p, std::size_t n) {
  const double largest = largest_magnitude(p, 3 * n);
  if (largest == 0) return {0, 0, 0};
  const double scale = fixed_point_scale(largest, n, 1);
  std::array<int64_t, 3> sum = {0, 0, 0};
  for (std::size_t i = 0; i < n; ++i) {
    for (std::size_t d = 0; d < 3; ++d) sum[d] += std::llrint(double{p[3 * i + d]} * scale);
  }
  Vec3 result;
  for (std::size_t d = 0; d < 3; ++d) {
    result[d] = static_cast<double>(sum[d]) / scale / static_cast<double>(n);
  }
  return result;
}

Vec3 centre_points(const float* p, std::size_t n, std::vector<float>& centred) {
  const Vec3 mean = mean_of(p, n);
  centred.resize(3 * n);
  const double x = mean[0], y = mean[1], z = mean[2];
  for (std::size_t i = 0; i < n; ++i) {
    centred[3 * i] = static_cast<float>(p[3 * i] - x);
    centred[3 * i + 1] = static_cast<float>(p[3 * i + 1] - y);
    centred[3 * i + 2] = static_cast<float>(p[3 * i + 2] - z);
  }
  return mean;
}

Mat3 covariance_of(const float* p, std::size_t n) {
  const double largest = largest_magnitude(p, 3 * n);
  Mat3 result = {};
  if (largest == 0) return result;
  const double scale = fixed_point_scale(largest, n, 2);
  int64_t sum[3][3] = {};
  for (std::size_t i = 0; i < n; ++i) {
    int64_t v[3];
    for (std::size_t d = 0; d < 3; ++d) v[d] = std::llrint(double{p[3 * i + d]} * scale);
    for (std::size_t a = 0; a < 3; ++a) {
      for (std::size_t b = a; b < 3; ++b) sum[a][b] += v[a] * v[b];
    }
  }
  for (std::size_t a = 0; a < 3; ++a) {
    for (std::size_t b = 0; b < 3; ++b) {
      const double value = static_cast<double>(sum[std::min(a, b)][std::max(a, b)]);
      result[a][b] = value / scale / scale / static_cast<double>(n);
    }
  }
  return result;
}

double major_angle(const Mat3& covariance) {
  return 0.5 * std::atan2(2 * covariance[0][1], covariance[0][0] - covariance[1][1]);
}

void segment_moments(const float* points, const int64_t* offsets, std::size_t segments, int threads,
                     double* means, double* eigenvalues) {
  parallel_for(segments, 8, threads, [&](std::size_t begin, std::size_t end, int) {
    std::vector<float> centred;
    for (std::size_t s = begin; s < end; ++s) {
      const float* p = points + 3 * offsets[s];
      const auto n = static_cast<std::size_t>(offsets[s + 1] - offsets[s]);
      Vec3 mean = {0, 0, 0}, values = {0, 0, 0};
      if (n > 0) {
        mean = centre_points(p, n, centred);
        values = eigen_axes(covariance_of(centred.data(), n)).values;
      }
      for (std::size_t d = 0; d < 3; ++d) {
        means[3 * s + d] = mean[d];
        eigenvalues[3 * s + d] = std::max(values[d], 0.0);
      }
    }
  });
}

}  // namespace segloc
