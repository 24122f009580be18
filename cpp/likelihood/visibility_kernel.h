// Pixels of a range image. The compiler turns the loop into vectors: no branches.
#pragma once

#include "common/angles.h"
#include "simd/kernels.h"
#include "simd/simd.h"

namespace segloc {
namespace SEGLOC_ISA {
namespace {

// Hastings' polynomial (Approximations for Digital Computers, 1955), in degrees; 0 of nothing.
inline double quick_atan2(double y, double x) {
  const double across = x < 0.0 ? -x : x, up = y < 0.0 ? -y : y;
  const double less = across < up ? across : up, more = across < up ? up : across;
  const double t = less / (more > 0.0 ? more : 1.0), t2 = t * t;
  const double odd =
      -0.33262347 + t2 * (0.19354346 + t2 * (-0.11643287 + t2 * (0.05265332 + t2 * -0.01172120)));
  double angle = t * (0.99997726 + t2 * odd) * kDegrees;
  angle = up > across ? 90.0 - angle : angle;
  angle = x < 0.0 ? 180.0 - angle : angle;
  return y < 0.0 ? -angle : angle;
}

void range_pixels(const float* points, size_t count, const PixelGrid& grid, int32_t* pixels,
                  float* ranges) {
  const double bin = grid.bin_deg, least = grid.doubt, most = 1.0 - grid.doubt;
  const int32_t columns = grid.columns, rows = grid.rows;
  for (size_t i = 0; i < count; ++i) {
    const double x = points[3 * i], y = points[3 * i + 1], z = points[3 * i + 2];
    const double level2 = x * x + y * y;
    const double across = (quick_atan2(y, x) + 180.0) / bin;
    const double up = (quick_atan2(z, __builtin_sqrt(level2)) + 90.0) / bin;
    const auto column = static_cast<int32_t>(across), row = static_cast<int32_t>(up);
    const double a = across - static_cast<double>(column), u = up - static_cast<double>(row);
    const double low = a < u ? a : u, high = a < u ? u : a;
    const int32_t pixel =
        (column < columns ? column : 0) * rows + (row < rows - 1 ? row : rows - 1);
    pixels[i] = low > least && high < most ? pixel : -1;
    ranges[i] = static_cast<float>(__builtin_sqrt(level2 + z * z));
  }
}

}  // namespace
}  // namespace SEGLOC_ISA
}  // namespace segloc
