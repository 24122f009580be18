#include "likelihood/visibility.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>

#include "common/angles.h"
#include "common/rigid.h"
#include "frontend/crop.h"

namespace segloc {
namespace {

constexpr float kFar = std::numeric_limits<float>::infinity();
constexpr double kBeyond = 1.01;     // radii that a point may lie beyond the range and be near
constexpr double kGroundCell = 3.0;  // metres
constexpr float kAbove = 0.5f;       // lower map points are not compared, metres
constexpr double kNearest = 0.05;    // points nearer than this are no wider, metres
constexpr double kSteepest = 0.1;    // nor are those that are steeper: the cosine of the elevation
constexpr std::size_t kChunk = 256;   // points whose pixels are found together
constexpr double kSlant = 0.05;      // surfaces met at a slant spread over a pixel by their range

double range_squared(const float* p) {
  return double(p[0]) * p[0] + double(p[1]) * p[1] + double(p[2]) * p[2];
}

// More than a quick angle of the kernel is ever wrong, degrees.
constexpr double kQuickError = 2e-3;

RangeImage image_of(const float* structure, std::size_t n, const float* ground, std::size_t g,
                    double bin_deg) {
  RangeImage image(bin_deg);
  image.add(structure, n);
  image.add(ground, g);
  return image;
}

}  // namespace

RangeImage::RangeImage(double bin_deg)
    : grid_{bin_deg, kQuickError / bin_deg, static_cast<int>(std::lround(360.0 / bin_deg)),
            static_cast<int>(std::lround(180.0 / bin_deg)) + 1},
      nearest_(static_cast<std::size_t>(grid_.columns) * grid_.rows, kFar) {}

void RangeImage::add(const float* points, std::size_t count, double half_width, float farthest) {
  // Points farther away are no wider than a pixel.
  const auto wide = static_cast<float>(2.0 * half_width * kDegrees / grid_.bin_deg);
  std::array<std::int32_t, kChunk> pixels;
  std::array<float, kChunk> ranges;
  for (std::size_t begin = 0; begin < count; begin += kChunk) {
    const std::size_t few = std::min(kChunk, count - begin);
    const float* chunk = points + 3 * begin;
    best_kernels().range_pixels(chunk, few, grid_, pixels.data(), ranges.data());
    for (std::size_t i = 0; i < few; ++i) {
      if (ranges[i] > farthest) continue;
      const float* point = chunk + 3 * i;
      const std::size_t pixel =
          pixels[i] < 0 ? exact_pixel(point) : static_cast<std::size_t>(pixels[i]);
      if (ranges[i] < wide) {
        widen(point, pixel, half_width);
      } else {
        nearest_[pixel] = std::min(nearest_[pixel], ranges[i]);
      }
    }
  }
}

void RangeImage::widen(const float* point, std::size_t pixel, double half_width) {
  const double range = std::max(std::sqrt(range_squared(point)), kNearest);
  const int up = static_cast<int>(half_width / range * kDegrees / grid_.bin_deg + 0.5);
  const double x = point[0], y = point[1];
  const double level = std::max(std::sqrt(x * x + y * y) / range, kSteepest);
  const int aside = std::min(static_cast<int>(std::ceil(up / level)), grid_.columns / 2);
  const int middle = static_cast<int>(pixel) / grid_.rows;
  const int row = static_cast<int>(pixel) % grid_.rows;
  const int low = std::max(row - up, 0), high = std::min(row + up, grid_.rows - 1);
  const auto nearest = static_cast<float>(range);
  for (int c = middle - aside; c <= middle + aside; ++c) {
    float* of = column(c);
    for (int r = low; r <= high; ++r) of[r] = std::min(of[r], nearest);
  }
}

float RangeImage::least_about(std::size_t pixel) const {
  const int middle = static_cast<int>(pixel) / grid_.rows, row = static_cast<int>(pixel) % grid_.rows;
  const int low = std::max(row - 1, 0), high = std::min(row + 1, grid_.rows - 1);
  float least = kFar;
  for (int c = middle - 1; c <= middle + 1; ++c) {
    const float* of = column(c);
    least = std::min(least, *std::min_element(of + low, of + high + 1));
  }
  return least;
}

bool FreeSpace::holds(const float* point, double range, double margin) const {
  const std::size_t pixel = image_.at(point);
  const double behind = range + std::max(margin, kSlant * range);
  return image_[pixel] < kFar && image_[pixel] > behind && image_.least_about(pixel) > behind;
}

std::size_t RangeImage::at(const float* point) const {
  std::int32_t pixel = 0;
  float range = 0.0f;
  best_kernels().range_pixels(point, 1, grid_, &pixel, &range);
  return pixel < 0 ? exact_pixel(point) : static_cast<std::size_t>(pixel);
}

std::size_t RangeImage::exact_pixel(const float* point) const {
  const double x = point[0], y = point[1], z = point[2];
  const auto bin_of = [&](double up, double across, double first_deg) {
    return static_cast<int>((std::atan2(up, across) * kDegrees + first_deg) / grid_.bin_deg);
  };
  const int column = bin_of(y, x, 180.0) % grid_.columns;
  const int row = std::min(bin_of(z, std::sqrt(x * x + y * y), 90.0), grid_.rows - 1);
  return static_cast<std::size_t>(column) * grid_.rows + row;
}

GroundCeiling::GroundCeiling(const float* ground, std::size_t count, double range)
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

float GroundCeiling::operator()(float x, float y) const {
  const int cx = std::clamp(cell(x), 0, side_ - 1), cy = std::clamp(cell(y), 0, side_ - 1);
  return height_[static_cast<std::size_t>(cy) * side_ + cx];
}

int GroundCeiling::cell(float v) const {
  const double c = std::floor(double(v) / kGroundCell) + side_ / 2;
  return static_cast<int>(std::clamp(c, -2.0, double(side_) + 1.0));
}

VisibilityCheck::VisibilityCheck(const float* structure, std::size_t n, const float* ground,
                                 std::size_t g, double range, double bin_deg, double radius)
    : VisibilityCheck(within_range(structure, n, range + kBeyond * radius), structure, n, ground, g,
                      range, bin_deg, radius) {}

VisibilityCheck::VisibilityCheck(const std::vector<float>& near, const float* structure,
                                 std::size_t n, const float* ground, std::size_t g, double range,
                                 double bin_deg, double radius)
    : range_(range),
      query_(near.data(), near.size() / 3, radius),
      free_(image_of(structure, n, ground, g, bin_deg)),
      floor_(ground, g, range) {}

VisibilityCheck::Counts VisibilityCheck::count(const float* map, std::size_t m, const double* T,
                                               double radius, double margin) const {
  const double max_range2 = range_ * range_;
  const auto limit = static_cast<float>(radius * radius);
  std::vector<float> places = moved_by(T, map, m);
  std::size_t compared = 0;
  for (std::size_t i = 0; i < m; ++i) {
    const float* p = &places[3 * i];
    if (!(range_squared(p) < max_range2)) continue;
    const float below = floor_(p[0], p[1]);
    if (below == -kFar || p[2] <= below + kAbove) continue;
    std::copy_n(p, 3, &places[3 * compared++]);
  }
  std::vector<float> squared(compared);
  query_.nearest_squared(places.data(), compared, limit, limit, squared.data());
  Counts counts;
  for (std::size_t i = 0; i < compared; ++i) {
    const float* p = &places[3 * i];
    if (squared[i] <= limit) {
      ++counts.confirmed;
    } else if (free_.holds(p, std::sqrt(range_squared(p)), margin)) {
      ++counts.violations;
    }
  }
  return counts;
}

}  // namespace segloc
