#include "likelihood/intrusion.h"

#include <array>
#include <cmath>
#include <utility>
#include <vector>

#include "common/rigid.h"
#include "likelihood/visibility.h"

namespace segloc {
namespace {

double norm(const float* p) {
  return std::sqrt(double(p[0]) * p[0] + double(p[1]) * p[1] + double(p[2]) * p[2]);
}

std::array<float, 3> from(const double* viewpoint, const float* p) {
  return {static_cast<float>(p[0] - viewpoint[0]), static_cast<float>(p[1] - viewpoint[1]),
          static_cast<float>(p[2] - viewpoint[2])};
}

// Points without one of the map near them, in the map's frame, one after another.
std::vector<float> unmapped(const PointIndex& map, const float* points, std::size_t m,
                            const double* T, const IntrusionOptions& options, std::size_t* used) {
  std::vector<float> left;
  for (std::size_t i = 0; i < m; ++i) {
    const float* p = points + 3 * i;
    if (norm(p) <= options.range) left.insert(left.end(), p, p + 3);
  }
  *used = left.size() / 3;
  left = moved_by(T, left.data(), *used);
  map.remove_near(left, options.radius);
  return left;
}

}  // namespace

Intrusion intrusion(const PointIndex& map, const float* points, std::size_t m, const double* T,
                    const double* viewpoints, std::size_t v, const IntrusionOptions& options) {
  Intrusion found;
  std::vector<float> left = unmapped(map, points, m, T, options, &found.used);
  const std::size_t all = left.size() / 3;
  for (std::size_t k = 0; k < v && !left.empty(); ++k) {
    const double* viewpoint = viewpoints + 3 * k;
    RangeImage image(options.bin_deg);
    map.visit(viewpoint[0], viewpoint[1], options.range, [&](const PointGrid::Point& p) {
      const auto seen = from(viewpoint, p.data());
      if (norm(seen.data()) <= options.range) image.add(seen.data(), options.half_width);
    });
    const FreeSpace free(image);
    const auto is_free = [&](const float* p) {
      const auto seen = from(viewpoint, p);
      const double range = norm(seen.data());
      return range < options.range && free.holds(seen.data(), range, options.margin);
    };
    std::vector<float> rest;
    for (std::size_t i = 0; i < left.size(); i += 3) {
      if (!is_free(&left[i])) rest.insert(rest.end(), &left[i], &left[i] + 3);
    }
    left = std::move(rest);
  }
  found.intruding = all - left.size() / 3;
  return found;
}

}  // namespace segloc
