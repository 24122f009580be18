#include "frontend/thinning.h"

#include <algorithm>
#include <numeric>
#include <stdexcept>

#include "common/cells.h"

namespace segloc {
namespace {

constexpr int kMostBits = 21;  // along an axis

// Voxels along an axis, from the lowest on.
struct Axis {
  double origin, voxel;
  std::int64_t low;
  int bits;

  Axis(const float* points, std::size_t n, double from, double size) : origin(from), voxel(size) {
    float least = points[0], most = points[0];
    for (std::size_t i = 0; i < n; ++i) {
      least = std::min(least, points[3 * i]);
      most = std::max(most, points[3 * i]);
    }
    constexpr double kFarthest = 1e18;  // voxels; differences fit 63 bits
    if (!(scaled(least) > -kFarthest && scaled(most) < kFarthest)) {
      throw std::invalid_argument("cloud too wide");
    }
    low = floor_of(scaled(least));
    const std::int64_t span = floor_of(scaled(most)) - low;
    for (bits = 0; span >> bits != 0;) ++bits;
    if (bits > kMostBits) throw std::invalid_argument("cloud too wide");
  }
  double scaled(float at) const { return (double{at} + origin) / voxel; }
};

}  // namespace

std::vector<std::uint32_t> central_points(const float* points, std::size_t n, const double* origin,
                                          double voxel) {
  if (n == 0) return {};
  const Axis axes[3] = {Axis(points, n, origin[0], voxel), Axis(points + 1, n, origin[1], voxel),
                        Axis(points + 2, n, origin[2], voxel)};
  const int bits = axes[0].bits + axes[1].bits + axes[2].bits;
  std::vector<std::uint64_t> keys(n);
  std::vector<double> distances(n);
  for (std::size_t i = 0; i < n; ++i) {
    for (int a = 0; a < 3; ++a) {
      const double at = axes[a].scaled(points[3 * i + static_cast<std::size_t>(a)]);
      const std::int64_t cell = floor_of(at);
      const double off = at - static_cast<double>(cell) - 0.5;
      keys[i] = keys[i] << axes[a].bits | static_cast<std::uint64_t>(cell - axes[a].low);
      distances[i] += off * off;
    }
  }
  std::vector<std::uint32_t> order(n);
  std::iota(order.begin(), order.end(), 0u);
  radix_sort(keys, order, bits);
  const auto nearer = [&](std::uint32_t a, std::uint32_t b) {
    if (distances[a] != distances[b]) return distances[a] < distances[b];
    const float *p = points + 3 * std::size_t{a}, *q = points + 3 * std::size_t{b};
    return std::lexicographical_compare(p, p + 3, q, q + 3);
  };
  std::size_t kept = 0;
  for (std::size_t i = 0; i < n; ++i) {
    if (i == 0 || keys[i] != keys[i - 1]) {
      order[kept++] = order[i];
    } else if (nearer(order[i], order[kept - 1])) {
      order[kept - 1] = order[i];
    }
  }
  order.resize(kept);
  return order;
}

}  // namespace segloc
