#include "descriptors/gestalt.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <vector>

#include "common/parallel.h"
#include "descriptors/moments.h"

namespace segloc {
namespace {

struct Bin {
  int64_t count = 0, sum = 0, sum2 = 0;  // of heights in fixed point
};

struct Frame {
  double cosine, sine;  // of the direction of x
};

// x lies across the major axis; at least half of the points lie below the middle of their range.
Frame key_frame(const std::vector<float>& centred, std::size_t n, const Mat3& covariance) {
  const double angle = major_angle(covariance);
  Frame frame = {-std::sin(angle), std::cos(angle)};
  double low = 0, high = 0;
  const auto along = [&](std::size_t i) {
    return frame.cosine * centred[3 * i] + frame.sine * centred[3 * i + 1];
  };
  for (std::size_t i = 0; i < n; ++i) {
    low = std::min(low, along(i));
    high = std::max(high, along(i));
  }
  std::size_t below = 0;
  for (std::size_t i = 0; i < n; ++i) below += along(i) < (low + high) / 2;
  if (2 * below < n) frame = {-frame.cosine, -frame.sine};
  return frame;
}

std::size_t bin_of(double x, double y, double radius) {
  constexpr double kTurn = 6.283185307179586;
  const double ring = std::floor(std::hypot(x, y) / radius * kGestaltRings);
  double angle = std::atan2(y, x);
  if (angle < 0) angle += kTurn;
  const auto sector = static_cast<std::size_t>(angle / kTurn * kGestaltSectors) % kGestaltSectors;
  return static_cast<std::size_t>(ring) * kGestaltSectors + sector;
}

using Bins = std::array<Bin, kGestaltBins>;

Bins filled_bins(const std::vector<float>& centred, std::size_t n, const Frame& frame,
                 double radius, double scale) {
  Bins bins;
  for (std::size_t i = 0; i < n; ++i) {
    const double x = frame.cosine * centred[3 * i] + frame.sine * centred[3 * i + 1];
    const double y = frame.cosine * centred[3 * i + 1] - frame.sine * centred[3 * i];
    if (!(std::hypot(x, y) < radius)) continue;
    Bin& bin = bins[bin_of(x, y, radius)];
    const int64_t height = std::llrint(centred[3 * i + 2] * scale);
    ++bin.count;
    bin.sum += height;
    bin.sum2 += height * height;
  }
  return bins;
}

// Means and variances; an empty bin takes those of the next ring inwards.
void write_bins(const Bins& bins, double scale, float* output) {
  for (std::size_t b = 0; b < kGestaltBins; ++b) {
    const auto count = static_cast<double>(bins[b].count);
    if (bins[b].count > 0) {
      const double height = static_cast<double>(bins[b].sum) / scale / count;
      const double square = static_cast<double>(bins[b].sum2) / scale / scale / count;
      output[b] = static_cast<float>(height);
      output[kGestaltBins + b] = static_cast<float>(std::max(square - height * height, 0.0));
    } else if (b >= kGestaltSectors) {
      output[b] = output[b - kGestaltSectors];
      output[kGestaltBins + b] = output[kGestaltBins + b - kGestaltSectors];
    }
  }
}

void write_shape(const Mat3& covariance, float* output) {
  const Vec3 values = eigen_axes(covariance).values;
  const double sum = values[0] + values[1] + values[2];
  if (sum <= 0) return;
  output[0] = static_cast<float>(2 * (values[1] - values[2]) / sum);
  output[1] = static_cast<float>((values[0] - values[1]) / sum);
}

void describe(const float* points, std::size_t n, double radius, std::vector<float>& centred,
              float* output) {
  centre_points(points, n, centred);
  const Mat3 covariance = covariance_of(centred.data(), n);
  const double largest = std::max(double{1e-30}, largest_magnitude(centred.data(), 3 * n));
  const double scale = fixed_point_scale(largest, n, 2);
  const Frame frame = key_frame(centred, n, covariance);
  write_bins(filled_bins(centred, n, frame, radius, scale), scale, output);
  write_shape(covariance, output + 2 * kGestaltBins);
}

}  // namespace

void gestalt(const float* points, const int64_t* offsets, std::size_t segments, double radius,
             int threads, float* output) {
  std::fill(output, output + segments * kGestaltSize, 0.0f);
  parallel_for(segments, 8, threads, [&](std::size_t begin, std::size_t end, int) {
    std::vector<float> centred;
    for (std::size_t s = begin; s < end; ++s) {
      const auto n = static_cast<std::size_t>(offsets[s + 1] - offsets[s]);
      if (n > 0) describe(points + 3 * offsets[s], n, radius, centred, output + s * kGestaltSize);
    }
  });
}

}  // namespace segloc
