#include "registration/surface.h"

#include <algorithm>
#include <cmath>
#include <limits>

namespace segloc {
namespace {

constexpr float kClose = 0.4f;      // share of the maximum distance that is searched first
constexpr std::size_t kFewest = 4;  // points that can be off a plane
constexpr double kPi = 3.14159265358979323846;

// Three signed steps of 21 bits and a bit that says that they are there.
constexpr std::uint64_t kKnown = std::uint64_t{1} << 63;
constexpr std::uint64_t kMask = (std::uint64_t{1} << 21) - 1;
constexpr double kSteps = double((1 << 20) - 1);

std::uint64_t packed(const Surface::Normal& n) {
  std::uint64_t bits = kKnown;
  for (int a = 0; a < 3; ++a) {
    bits |= (static_cast<std::uint64_t>(std::llrint(n[a] * kSteps) + (1 << 20)) & kMask)
            << (21 * a);
  }
  return bits;
}

Surface::Normal unpacked(std::uint64_t bits) {
  Surface::Normal n;
  for (int a = 0; a < 3; ++a) {
    n[a] = double(static_cast<std::int64_t>((bits >> (21 * a)) & kMask) - (1 << 20)) / kSteps;
  }
  return n;
}

// xx, xy, xz, yy, yz, zz of a symmetric matrix.
using Symmetric = std::array<double, 6>;

// The direction of the least eigenvalue, by the closed form of Smith (CACM, 1961); zero where it is
// no single direction.
Surface::Normal least_axis(const Symmetric& c) {
  const double mean = (c[0] + c[3] + c[5]) / 3.0;
  const double x = c[0] - mean, y = c[3] - mean, z = c[5] - mean;
  const double off = c[1] * c[1] + c[2] * c[2] + c[4] * c[4];
  const double p = std::sqrt((x * x + y * y + z * z + 2.0 * off) / 6.0);
  if (!(p > 1e-9 * mean)) return {0, 0, 0};
  const double det =
      x * (y * z - c[4] * c[4]) - c[1] * (c[1] * z - c[4] * c[2]) + c[2] * (c[1] * c[4] - y * c[2]);
  const double angle = std::acos(std::clamp(det / (2.0 * p * p * p), -1.0, 1.0)) / 3.0;
  const double least = 2.0 * p * std::cos(angle + 2.0 * kPi / 3.0);
  // Rows of (matrix - least) are normal to the axis: the longest product of two of them is it.
  const double rows[3][3] = {
      {x - least, c[1], c[2]}, {c[1], y - least, c[4]}, {c[2], c[4], z - least}};
  Surface::Normal best = {0, 0, 0};
  double longest = 0.0;
  for (int i = 0; i < 3; ++i) {
    const double *a = rows[i], *b = rows[(i + 1) % 3];
    const Surface::Normal n = {a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2],
                               a[0] * b[1] - a[1] * b[0]};
    const double squared = n[0] * n[0] + n[1] * n[1] + n[2] * n[2];
    if (squared > longest) longest = squared, best = n;
  }
  if (!(longest > 1e-12 * p * p * p * p)) return {0, 0, 0};
  for (double& v : best) v /= std::sqrt(longest);
  return best;
}

}  // namespace

Surface::Surface(const float* points, std::size_t n, double max_correspondence_distance,
                 double support)
    : grid_(points, n, std::max(max_correspondence_distance, support)),
      max_correspondence_distance_(max_correspondence_distance),
      support_(support),
      normals_(new std::atomic<std::uint64_t>[n]()) {}

// Most points have another close by: a small neighbourhood is searched first.
Surface::Nearest Surface::nearest(const PointGrid::Point& p) const {
  for (const float share : {kClose, 1.0f}) {
    const auto limit = static_cast<float>(max_correspondence_distance_) * share;
    float best = limit * limit, next = best;
    std::uint32_t point = kNone;
    grid_.visit(p, limit, [&](std::uint32_t i, float squared) {
      if (squared < best || (squared == best && point == kNone)) {
        next = best;
        best = squared;
        point = i;
      } else {
        next = std::min(next, squared);
      }
    });
    if (point != kNone) return {point, std::sqrt(best), std::sqrt(next)};
  }
  return {kNone, std::numeric_limits<float>::infinity(),
          static_cast<float>(max_correspondence_distance_)};
}

Surface::Normal Surface::normal(std::size_t i) const {
  std::uint64_t bits = normals_[i].load(std::memory_order_relaxed);
  if (bits == 0) {
    bits = packed(found(i));
    normals_[i].store(bits, std::memory_order_relaxed);
  }
  return unpacked(bits);
}

Surface::Normal Surface::found(std::size_t i) const {
  const PointGrid::Point& p = grid_[i];
  const auto limit = static_cast<float>(support_ * support_);
  double sum[3] = {0, 0, 0};
  Symmetric squares = {0, 0, 0, 0, 0, 0};
  std::size_t count = 0;
  grid_.visit(p, support_, [&](std::uint32_t k, float squared) {
    if (squared > limit) return;
    const double d[3] = {double{grid_[k][0]} - p[0], double{grid_[k][1]} - p[1],
                         double{grid_[k][2]} - p[2]};
    for (int a = 0; a < 3; ++a) sum[a] += d[a];
    squares[0] += d[0] * d[0], squares[1] += d[0] * d[1], squares[2] += d[0] * d[2];
    squares[3] += d[1] * d[1], squares[4] += d[1] * d[2], squares[5] += d[2] * d[2];
    ++count;
  });
  if (count < kFewest) return {0, 0, 0};
  const double n = static_cast<double>(count), x = sum[0] / n, y = sum[1] / n, z = sum[2] / n;
  return least_axis({squares[0] / n - x * x, squares[1] / n - x * y, squares[2] / n - x * z,
                     squares[3] / n - y * y, squares[4] / n - y * z, squares[5] / n - z * z});
}

}  // namespace segloc
