#include "likelihood/surface.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <memory>

#include "common/principal_axes.h"

namespace segloc {
namespace {

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

std::vector<GridNearest> Surface::nearest(const std::vector<float>& places, double lead) const {
  std::vector<GridNearest> found(places.size() / 3);
  const auto limit = static_cast<float>(max_correspondence_distance_);
  const auto around = static_cast<float>(lead);
  grid_.nearest(places.data(), found.size(), limit * limit, around * around, found.data());
  return found;
}

std::vector<Surface::Normal> Surface::normals(const std::vector<std::uint32_t>& points) const {
  std::vector<Normal> found(points.size());
  std::vector<std::size_t> fresh;
  std::vector<float> places;
  for (std::size_t k = 0; k < points.size(); ++k) {
    const std::uint64_t bits = normals_[points[k]].load(std::memory_order_relaxed);
    if (bits != 0) {
      found[k] = unpacked(bits);
      continue;
    }
    const PointGrid::Point p = grid_[points[k]];
    places.insert(places.end(), p.begin(), p.end());
    fresh.push_back(k);
  }
  std::vector<PointSums> around(fresh.size());
  grid_.sums_within(places.data(), fresh.size(), static_cast<float>(support_ * support_),
                    around.data());
  for (std::size_t i = 0; i < fresh.size(); ++i) {
    const bool spans = around[i].count >= kFewest;
    const std::uint64_t bits =
        packed(spans ? principal_axes(covariance(around[i])).least_axis : Normal{0, 0, 0});
    normals_[points[fresh[i]]].store(bits, std::memory_order_relaxed);
    found[fresh[i]] = unpacked(bits);
  }
  return found;
}

std::vector<std::uint32_t> every(const Surface& surface, std::size_t step) {
  std::vector<std::uint32_t> sampled;
  for (std::size_t i = 0; i < surface.size(); i += step) {
    sampled.push_back(static_cast<std::uint32_t>(i));
  }
  return sampled;
}

std::vector<float> off_plane(const Surface& target, const Surface& source, const Rigid& T,
                             std::size_t step, const Slope& slope) {
  const auto known = [](const Surface::Normal& n) { return n[0] != 0 || n[1] != 0 || n[2] != 0; };
  const std::vector<std::uint32_t> sampled = every(source, step);
  const std::vector<Surface::Normal> own = source.normals(sampled);
  std::vector<float> distances(sampled.size(), std::numeric_limits<float>::quiet_NaN());
  std::vector<std::size_t> sloping;
  std::vector<std::array<double, 3>> moved;
  std::vector<float> places;
  for (std::size_t k = 0; k < sampled.size(); ++k) {
    const Surface::Normal& n = own[k];
    const double up = std::abs(T.R[6] * n[0] + T.R[7] * n[1] + T.R[8] * n[2]);
    if (!known(n) || !(up > slope.least && up < slope.most)) continue;
    const PointGrid::Point s = source.grid()[sampled[k]];
    const double p[3] = {s[0], s[1], s[2]};
    distances[k] = std::numeric_limits<float>::infinity();
    sloping.push_back(k);
    moved.push_back(T.apply(p));
    for (const double v : moved.back()) places.push_back(static_cast<float>(v));
  }
  std::vector<std::uint32_t> targets;
  const std::vector<GridNearest> nearest = target.nearest(places);
  for (std::size_t k = 0; k < nearest.size(); ++k) {
    if (nearest[k].point == kNoPoint) continue;
    moved[targets.size()] = moved[k];
    sloping[targets.size()] = sloping[k];
    targets.push_back(nearest[k].point);
  }
  const std::vector<Surface::Normal> normals = target.normals(targets);
  for (std::size_t k = 0; k < targets.size(); ++k) {
    const Surface::Normal& n = normals[k];
    if (!known(n)) continue;
    const PointGrid::Point t = target.grid()[targets[k]];
    const std::array<double, 3>& p = moved[k];
    const double off = n[0] * (p[0] - t[0]) + n[1] * (p[1] - t[1]) + n[2] * (p[2] - t[2]);
    distances[sloping[k]] = static_cast<float>(std::abs(off));
  }
  return distances;
}

}  // namespace segloc
