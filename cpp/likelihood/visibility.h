// Visibility of the map from one query scan: which of its points the scan confirms, and which
// violate the free space that the scan has measured.
#pragma once

#include <cmath>
#include <cstddef>
#include <cstdint>
#include <limits>
#include <utility>
#include <vector>

#include "frontend/point_grid.h"
#include "simd/kernels.h"

namespace segloc {

// The nearest range in every direction.
class RangeImage {
 public:
  explicit RangeImage(double bin_deg);
  // Points up to `farthest` metres away; each stands for all within `half_width` metres of it.
  void add(const float* points, std::size_t count, double half_width = 0.0,
           float farthest = std::numeric_limits<float>::infinity());
  std::size_t at(const float* point) const;
  // The least of a pixel and the eight about it.
  float least_about(std::size_t pixel) const;
  float operator[](std::size_t pixel) const { return nearest_[pixel]; }

 private:
  std::size_t exact_pixel(const float* point) const;
  void widen(const float* point, std::size_t pixel, double half_width);
  // Its first pixel; columns go around.
  const float* column(int c) const {
    const int turned = c < 0 ? c + grid_.columns : c < grid_.columns ? c : c - grid_.columns;
    return &nearest_[static_cast<std::size_t>(turned) * grid_.rows];
  }
  float* column(int c) { return const_cast<float*>(std::as_const(*this).column(c)); }

  PixelGrid grid_;
  std::vector<float> nearest_;
};

// Free space around a sensor, by its range image.
class FreeSpace {
 public:
  explicit FreeSpace(RangeImage image) : image_(std::move(image)) {}
  // Whether something is measured in a point's direction, and all that is there and about it lies
  // more than `margin` metres, and more than a share of the range, behind the point.
  bool holds(const float* point, double range, double margin) const;
  // Whether what is measured in a point's direction lies within `margin` metres of it.
  bool ends_at(const float* point, double range, double margin) const {
    return std::abs(image_[image_.at(point)] - range) <= margin;
  }

 private:
  RangeImage image_;
};

// The highest ground of each cell and of the eight about it.
class GroundCeiling {
 public:
  GroundCeiling(const float* ground, std::size_t count, double range);
  float operator()(float x, float y) const;  // minus infinity where there is no ground

 private:
  int cell(float v) const;

  int side_;
  std::vector<float> height_;
};

// One query cloud, whose frame has its z axis up and its origin at the sensor.
class VisibilityCheck {
 public:
  struct Counts {
    std::int64_t confirmed = 0;   // map points with a query point near them
    std::int64_t violations = 0;  // others that lie in free space
  };

  // `structure` (n, 3) is above `ground` (g, 3). Map points are compared up to `range` metres, in
  // directions `bin_deg` wide; `count` takes any radius up to `radius`.
  VisibilityCheck(const float* structure, std::size_t n, const float* ground, std::size_t g,
                  double range, double bin_deg, double radius);

  // `map` (m, 3) are points of the map, and T (4, 4) takes them to the query frame. A map point is
  // a free-space violation where its pixel of the query's range image is measured, and all that is
  // measured in that pixel and about it lies more than `margin` metres, and more than a share of
  // the range, behind the point. Points close to the query's ground are not compared.
  Counts count(const float* map, std::size_t m, const double* T, double radius,
               double margin) const;

  double radius() const { return query_.radius(); }

 private:
  VisibilityCheck(const std::vector<float>& near, const float* structure, std::size_t n,
                  const float* ground, std::size_t g, double range, double bin_deg, double radius);

  double range_;
  PointGrid query_;  // of what is near enough
  FreeSpace free_;
  GroundCeiling floor_;
};

}  // namespace segloc
