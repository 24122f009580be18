#include "sight.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <vector>

#include "point_index.h"

namespace segloc {
namespace {

constexpr double kDegrees = 180.0 / 3.14159265358979323846;
constexpr float kFar = std::numeric_limits<float>::infinity();
constexpr double kGroundCell = 3.0;  // metres

// The nearest range in every direction.
class RangeImage {
 public:
  explicit RangeImage(double bin_deg)
      : bin_(bin_deg),
        columns_(static_cast<int>(std::lround(360.0 / bin_deg))),
        rows_(static_cast<int>(std::lround(180.0 / bin_deg)) + 1),
        nearest_(static_cast<std::size_t>(columns_) * rows_, kFar) {}

  void add(const float* p) {
    float& pixel = nearest_[at(p)];
    pixel = std::min(pixel, static_cast<float>(std::sqrt(range_squared(p))));
  }

  // The least of each pixel and the eight about it.
  RangeImage eroded() const {
    RangeImage least = *this;
    for (int c = 0; c < columns_; ++c) {
      for (int r = 0; r < rows_; ++r) {
        float value = kFar;
        for (int dc = -1; dc <= 1; ++dc) {
          const int column = (c + dc + columns_) % columns_;
          for (int row = std::max(r - 1, 0); row <= std::min(r + 1, rows_ - 1); ++row) {
            value = std::min(value, nearest_[static_cast<std::size_t>(column) * rows_ + row]);
          }
        }
        least.nearest_[static_cast<std::size_t>(c) * rows_ + r] = value;
      }
    }
    return least;
  }

  std::size_t at(const float* p) const {
    const double x = p[0], y = p[1], z = p[2];
    const double azimuth = std::atan2(y, x) * kDegrees + 180.0;
    const double elevation = std::atan2(z, std::hypot(x, y)) * kDegrees + 90.0;
    const int column = static_cast<int>(azimuth / bin_) % columns_;
    const int row = std::min(static_cast<int>(elevation / bin_), rows_ - 1);
    return static_cast<std::size_t>(column) * rows_ + row;
  }

  float operator[](std::size_t pixel) const { return nearest_[pixel]; }

  static double range_squared(const float* p) {
    return double(p[0]) * p[0] + double(p[1]) * p[1] + double(p[2]) * p[2];
  }

 private:
  double bin_;
  int columns_, rows_;
  std::vector<float> nearest_;
};

// The highest ground of each cell and of the eight about it.
class GroundCeiling {
 public:
  GroundCeiling(const float* ground, std::size_t count, double range)
      : side_(2 * static_cast<int>(std::ceil(range / kGroundCell)) + 3),
        height_(static_cast<std::size_t>(side_) * side_, -kFar) {
    for (std::size_t i = 0; i < count; ++i) {
      const float* p = ground + 3 * i;
      const int x = cell(p[0]), y = cell(p[1]);
      for (int cy = std::max(y - 1, 0); cy <= std::min(y + 1, side_ - 1); ++cy) {
        for (int cx = std::max(x - 1, 0); cx <= std::min(x + 1, side_ - 1); ++cx) {
          float& h = height_[static_cast<std::size_t>(cy) * side_ + cx];
          h = std::max(h, p[2]);
        }
      }
    }
  }

  // Minus infinity where there is no ground.
  float operator()(float x, float y) const {
    const int cx = std::clamp(cell(x), 0, side_ - 1), cy = std::clamp(cell(y), 0, side_ - 1);
    return height_[static_cast<std::size_t>(cy) * side_ + cx];
  }

 private:
  int cell(float v) const {
    const double c = std::floor(double(v) / kGroundCell) + side_ / 2;
    return static_cast<int>(std::clamp(c, -2.0, double(side_) + 1.0));
  }

  int side_;
  std::vector<float> height_;
};

}  // namespace

Sight sight(const float* structure, std::size_t n, const float* ground, std::size_t g,
            const float* site, std::size_t m, const double* T, const SightOptions& options) {
  RangeImage image(options.bin_deg);
  for (std::size_t i = 0; i < n; ++i) image.add(structure + 3 * i);
  for (std::size_t i = 0; i < g; ++i) image.add(ground + 3 * i);
  const RangeImage nearest = image.eroded();
  const GroundCeiling floor(ground, g, options.range);
  const PointIndex live(structure, n, options.near);
  const double range_squared = options.range * options.range;
  const auto near_squared = static_cast<float>(options.near * options.near);

  Sight result;
  for (std::size_t i = 0; i < m; ++i) {
    const float* p = site + 3 * i;
    float moved[3];
    for (int a = 0; a < 3; ++a) {
      moved[a] = static_cast<float>(T[4 * a] * p[0] + T[4 * a + 1] * p[1] + T[4 * a + 2] * p[2] + T[4 * a + 3]);
    }
    const double r2 = RangeImage::range_squared(moved);
    if (!(r2 < range_squared)) continue;
    const float below = floor(moved[0], moved[1]);
    if (below == -kFar || moved[2] <= below + options.above) continue;
    if (live.nearest_squared({moved[0], moved[1], moved[2]}, near_squared) <= near_squared) {
      ++result.seen;
      continue;
    }
    const std::size_t pixel = image.at(moved);
    const double range = std::sqrt(r2);
    const double behind = range + std::max(options.margin, options.slant * range);
    if (image[pixel] < kFar && nearest[pixel] > behind) ++result.through;
  }
  return result;
}

}  // namespace segloc
