#include "likelihood/known_space.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <utility>

#include "common/rigid.h"

namespace segloc {
namespace {

std::array<float, 3> from(const double* viewpoint, const float* p) {
  return {static_cast<float>(p[0] - viewpoint[0]), static_cast<float>(p[1] - viewpoint[1]),
          static_cast<float>(p[2] - viewpoint[2])};
}

double norm(const float* p) {
  return std::sqrt(double(p[0]) * p[0] + double(p[1]) * p[1] + double(p[2]) * p[2]);
}

}  // namespace

KnownSpace::KnownSpace(const PointIndex& map, const double* viewpoints, std::size_t v,
                       const KnownSpaceOptions& options)
    : map_(map), viewpoints_(viewpoints, viewpoints + 3 * v), options_(options) {}

std::vector<std::size_t> KnownSpace::nearest(const double* place) const {
  std::vector<std::pair<double, std::size_t>> near;
  for (std::size_t k = 0; 3 * k < viewpoints_.size(); ++k) {
    const double* at = &viewpoints_[3 * k];
    const double metres = std::hypot(at[0] - place[0], at[1] - place[1]);
    if (metres < 2.0 * options_.range && std::abs(at[2] - place[2]) < options_.storey) {
      near.emplace_back(metres, k);
    }
  }
  const std::size_t few = std::min(options_.most, near.size());
  std::partial_sort(near.begin(), near.begin() + std::ptrdiff_t(few), near.end());
  std::vector<std::size_t> found;
  for (std::size_t k = 0; k < few; ++k) found.push_back(near[k].second);
  return found;
}

KnownSpace::Image KnownSpace::image(std::size_t viewpoint) const {
  {
    const std::lock_guard<std::mutex> lock(mutex_);
    if (const auto found = kept_.find(viewpoint); found != kept_.end()) {
      used_.splice(used_.begin(), used_, found->second.place);
      return found->second.image;
    }
  }
  const double* at = &viewpoints_[3 * viewpoint];
  std::vector<float> rays;
  map_.visit(at[0], at[1], options_.range, [&](const PointGrid::Point& p) {
    const auto ray = from(at, p.data());
    rays.insert(rays.end(), ray.begin(), ray.end());
  });
  RangeImage seen(options_.bin_deg);
  seen.add(rays.data(), rays.size() / 3, options_.half_width, static_cast<float>(options_.range));
  Image made = std::make_shared<const FreeSpace>(std::move(seen));
  const std::lock_guard<std::mutex> lock(mutex_);
  if (kept_.find(viewpoint) == kept_.end()) {
    used_.push_front(viewpoint);
    kept_[viewpoint] = {made, used_.begin()};
    if (kept_.size() > options_.images) {
      kept_.erase(used_.back());
      used_.pop_back();
    }
  }
  return made;
}

std::vector<std::uint8_t> KnownSpace::codes(const float* points, std::size_t m, const double* T,
                                            double radius) const {
  const std::vector<float> places = moved_by(T, points, m);
  const std::vector<bool> near = map_.is_near(places, radius);
  std::vector<std::uint8_t> codes(m, std::uint8_t(Known::kUnknown));
  std::vector<std::size_t> left;
  for (std::size_t i = 0; i < m; ++i) {
    if (near[i]) {
      codes[i] = std::uint8_t(Known::kHit);
    } else {
      left.push_back(i);
    }
  }
  const double place[3] = {T[3], T[7], T[11]};
  for (const std::size_t viewpoint : nearest(place)) {
    if (left.empty()) break;
    const Image view = image(viewpoint);
    std::vector<std::size_t> rest;  // that no viewpoint looked through so far
    for (const std::size_t i : left) {
      const auto ray = from(&viewpoints_[3 * viewpoint], &places[3 * i]);
      const double range = norm(ray.data());
      if (range < options_.range) {
        if (view->holds(ray.data(), range, options_.margin)) {
          codes[i] = std::uint8_t(Known::kThrough);
          continue;
        }
        if (view->ends_at(ray.data(), range, options_.margin)) {
          codes[i] = std::uint8_t(Known::kMissed);
        }
      }
      rest.push_back(i);
    }
    left = std::move(rest);
  }
  return codes;
}

}  // namespace segloc
