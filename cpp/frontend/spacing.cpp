#include "frontend/spacing.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <vector>

namespace segloc {
namespace {

float squared_distance(const float* p, const float* q) {
  const float dx = p[0] - q[0], dy = p[1] - q[1], dz = p[2] - q[2];
  return dx * dx + dy * dy + dz * dz;
}

constexpr std::size_t kNearby = 1024;  // rows about a point that most find their neighbours in

// Squared distance to the second nearest other point of those fewer than `reach` rows away; any
// that is no more than `enough` will do.
float second_nearest(const float* points, std::size_t n, std::size_t i, float enough,
                     std::size_t reach) {
  const float* p = points + 3 * i;
  float first = std::numeric_limits<float>::max(), second = first;
  const auto meet = [&](const float* q) {
    const float squared = squared_distance(p, q);
    second = std::min(second, std::max(first, squared));
    first = std::min(first, squared);
  };
  for (std::size_t step = 1; step < reach && second > enough; ++step) {
    if (step <= i) meet(p - 3 * step);
    if (i + step < n) meet(p + 3 * step);
  }
  return second;
}

}  // namespace

double point_spacing(const float* points, std::size_t n, double least, std::size_t most) {
  if (n < 3 || most == 0) return least;
  const std::size_t count = std::min(n, most);
  const auto enough = static_cast<float>(least * least);
  std::vector<float> squared(count);
  for (const std::size_t reach : {std::min(kNearby, n), n}) {
    std::size_t settled = 0;
    for (std::size_t k = 0; k < count; ++k) {
      squared[k] = second_nearest(points, n, k * n / count, enough, reach);
      settled += squared[k] <= enough;
    }
    if (settled > count / 2) return least;
  }
  const auto middle = squared.begin() + static_cast<std::ptrdiff_t>(count / 2);
  std::nth_element(squared.begin(), middle, squared.end());
  return std::max(least, std::sqrt(static_cast<double>(*middle)));
}

}  // namespace segloc
