#include "frontend/crop.h"

namespace segloc {

std::vector<float> moved_crop(const float* points, std::size_t n, const Rigid& T, double radius) {
  std::vector<float> kept(3 * n);
  std::size_t size = 0;
  for (std::size_t i = 0; i < n; ++i) {
    const double at[3] = {points[3 * i], points[3 * i + 1], points[3 * i + 2]};
    const std::array<double, 3> p = T.apply(at);
    // What is not kept is written over by the next one: no branch to guess.
    for (std::size_t a = 0; a < 3; ++a) kept[size + a] = static_cast<float>(p[a]);
    size += is_near_axis(p, radius) ? 3 : 0;
  }
  kept.resize(size);
  return kept;
}

std::vector<float> within_range(const float* points, std::size_t n, double range) {
  std::vector<float> kept(3 * n);
  std::size_t size = 0;
  for (const float* p = points; p < points + 3 * n; p += 3) {  // no branch to guess, as above
    for (std::size_t a = 0; a < 3; ++a) kept[size + a] = p[a];
    const double square = double{p[0]} * p[0] + double{p[1]} * p[1] + double{p[2]} * p[2];
    size += square <= range * range ? 3 : 0;
  }
  kept.resize(size);
  return kept;
}

}  // namespace segloc
