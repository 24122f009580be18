// Small clouds of any coordinates that a binding lets through, in cells of any size.
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <cstdlib>
#include <cstring>
#include <stdexcept>
#include <vector>

#include "common/cells.h"
#include "frontend/cluster.h"
#include "frontend/ground.h"
#include "likelihood/known_space.h"
#include "likelihood/point_index.h"

namespace {

template <typename Call>
void attempt(const Call& call) {
  try {
    call();
  } catch (const std::invalid_argument&) {
  }
}

void require_finite(const std::vector<float>& values) {
  for (const float v : values) {
    if (!std::isfinite(v)) std::abort();
  }
}

}  // namespace

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  constexpr std::size_t kPoint = 3 * sizeof(float), kMost = 64;
  float length;
  if (size < sizeof(length)) return 0;
  std::memcpy(&length, data, sizeof(length));
  if (!(length >= 1e-6f && length <= 1e9f)) return 0;
  std::vector<float> points;
  for (std::size_t at = 4; at + kPoint <= size && points.size() < 3 * kMost; at += kPoint) {
    float p[3];
    std::memcpy(p, data + at, kPoint);
    for (const float v : p) {
      if (!(std::fabs(v) < 1e15f)) return 0;
      points.push_back(v);
    }
  }
  const std::size_t n = points.size() / 3;
  attempt([&] { require_finite(segloc::voxel_grid(points.data(), n, length)); });
  attempt([&] { segloc::euclidean_clusters(points.data(), n, length, 1, n); });
  attempt([&] {
    const std::vector<float> heights(points.begin(), points.begin() + std::ptrdiff_t(n));
    segloc::clusters_above(points.data(), heights.data(), n, {length, 0.0, length}, length, 1, n);
  });
  attempt([&] {
    const segloc::PointIndex index(points.data(), n, length);
    const double T[16] = {0, -1, 0, 3, 1, 0, 0, -2, 0, 0, 1, 1e14, 0, 0, 0, 1};
    index.overlap(points.data(), n, T, length, true);
    const double views[6] = {0, 0, 0, 3, 4, -1e14};
    const segloc::KnownSpace known(index, views, 2, {});
    known.codes(points.data(), n, T, length);
    if (n > 0) require_finite(index.sample({points[0], points[1], length}, 5));
  });
  // A grid of millions of cells is allowed, and slow: only narrow clouds go on.
  float low[2] = {1e30f, 1e30f}, high[2] = {-1e30f, -1e30f};
  for (std::size_t i = 0; i < n; ++i) {
    for (int a = 0; a < 2; ++a) {
      low[a] = std::fmin(low[a], points[3 * i + a]);
      high[a] = std::fmax(high[a], points[3 * i + a]);
    }
  }
  const double wide = (double{high[0]} - low[0]) / length,
               deep = (double{high[1]} - low[1]) / length;
  if (n > 0 && (wide + 1.0) * (deep + 1.0) < 1e4) {
    attempt([&] {
      require_finite(segloc::heights_above_ground(points.data(), n, {length, 0.2, 0.3}));
    });
  }
  return 0;
}
