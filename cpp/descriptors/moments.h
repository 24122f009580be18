// Mean and covariance of a segment. Sums are taken in fixed point, which is exact:
// nothing depends on the order of the points.
#pragma once

#include <cstddef>
#include <cstdint>
#include <vector>

#include "common/eigen_axes.h"

namespace segloc {

// A power of two that turns values up to `largest` into integers whose `order`-th powers, summed
// over n terms, stay within 62 bits.
double fixed_point_scale(double largest, std::size_t n, int order);

// The largest magnitude among `count` values.
double largest_magnitude(const float* values, std::size_t count);

// Of n > 0 points (n, 3).
Vec3 mean_of(const float* points, std::size_t n);

// Fills `centred` with n > 0 points about their mean, which is returned.
Vec3 centre_points(const float* points, std::size_t n, std::vector<float>& centred);

// Of n > 0 points (n, 3) that are centred on their mean.
Mat3 covariance_of(const float* centred, std::size_t n);

// Angle of the major axis in the xy plane.
double major_angle(const Mat3& covariance);

// Means (segments, 3) and eigenvalues of the covariances (segments, 3), falling and not negative;
// zeros for an empty segment.
void segment_moments(const float* points, const int64_t* offsets, std::size_t segments, int threads,
                     double* means, double* eigenvalues);

}  // namespace segloc
