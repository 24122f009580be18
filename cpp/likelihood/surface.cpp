#include "likelihood/surface.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <memory>

#include "common/principal_axes.h"

namespace segloc {
namespace {

constexpr float kClose = 0.4f;      // share of the maximum distance that is searched first
constexpr double kRounding = 1e-3;  // metres
constexpr std::size_t kFewest = 4;  // points that can be off a plane
constexpr std::int64_t kTileCells = 10;

// Three signed steps of 21 bits and a bit that is set if they are valid.
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

}  // namespace

Surface::Surface(const float* points, std::size_t n, double max_correspondence_distance,
                 double support, bool tiled, std::vector<std::uint32_t>* rows)
    : grid_(points, n, std::max(max_correspondence_distance, support), tiled ? kTileCells : 0,
            rows),
      max_correspondence_distance_(max_correspondence_distance),
      support_(support),
      normals_(n) {}

std::atomic<std::uint64_t>& Surface::Blocks::operator[](std::size_t i) {
  std::atomic<Block*>& place = blocks_[i / kBlock];
  Block* block = place.load(std::memory_order_acquire);
  if (block == nullptr) {
    auto fresh = std::make_unique<Block>();
    for (std::atomic<std::uint64_t>& normal : *fresh) normal.store(0, std::memory_order_relaxed);
    // Another thread may have been first: then its block stays.
    if (place.compare_exchange_strong(block, fresh.get(), std::memory_order_acq_rel)) {
      block = fresh.release();
    }
  }
  return (*block)[i % kBlock];
}

// Most points have another close by: a small neighbourhood is searched first.
Surface::Nearest Surface::nearest(const PointGrid::Point& p) const {
  for (const float share : {kClose, 1.0f}) {
    const auto limit = static_cast<float>(max_correspondence_distance_) * share;
    const PointGrid::Nearest found = grid_.nearest(p, limit);
    if (found.point != kNone) {
      return {found.point, std::sqrt(found.squared), std::sqrt(found.next)};
    }
  }
  return {kNone, std::numeric_limits<float>::infinity(),
          static_cast<float>(max_correspondence_distance_)};
}

float Surface::room(const PointGrid::Point& p) const {
  const double clear = grid_.clearance(p, max_correspondence_distance_);
  return static_cast<float>(clear - max_correspondence_distance_ - kRounding);
}

Surface::Normal Surface::normal(std::size_t i) const {
  std::atomic<std::uint64_t>& known = normals_[i];
  std::uint64_t bits = known.load(std::memory_order_relaxed);
  if (bits == 0) {
    bits = packed(found(i));
    known.store(bits, std::memory_order_relaxed);
  }
  return unpacked(bits);
}

Surface::Normal Surface::found(std::size_t i) const {
  const PointGrid::Point p = grid_[i];
  const auto limit = static_cast<float>(support_ * support_);
  Moments around;
  grid_.visit(p, support_, [&](std::uint32_t k, float squared) {
    if (squared <= limit) around.add(grid_[k], p);
  });
  if (around.count() < kFewest) return {0, 0, 0};
  return principal_axes(around.covariance()).least_axis;
}

OnPlane on_plane(const Surface& target, const Surface& source, const Rigid& T, std::size_t step,
                 const Slope& slope, double tolerance) {
  const auto known = [](const Surface::Normal& n) { return n[0] != 0 || n[1] != 0 || n[2] != 0; };
  OnPlane count{0, 0};
  for (std::size_t i = 0; i < source.size(); i += step) {
    const Surface::Normal own = source.normal(i);
    const double up = std::abs(T.R[6] * own[0] + T.R[7] * own[1] + T.R[8] * own[2]);
    if (!known(own) || !(up > slope.least && up < slope.most)) continue;
    const PointGrid::Point s = source.grid()[i];
    const double p[3] = {s[0], s[1], s[2]};
    const auto moved = T.apply(p);
    const Surface::Nearest nearest = target.nearest(
        {static_cast<float>(moved[0]), static_cast<float>(moved[1]), static_cast<float>(moved[2])});
    if (nearest.point == Surface::kNone) continue;
    const Surface::Normal n = target.normal(nearest.point);
    if (!known(n)) continue;
    const PointGrid::Point t = target.grid()[nearest.point];
    const double off =
        n[0] * (moved[0] - t[0]) + n[1] * (moved[1] - t[1]) + n[2] * (moved[2] - t[2]);
    ++count.of;
    count.hits += std::abs(off) < tolerance;
  }
  return count;
}

}  // namespace segloc
