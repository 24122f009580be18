// Covariance of points and its principal directions.
#pragma once

#include <array>

#include "simd/kernels.h"

namespace segloc {

// xx, xy, xz, yy, yz, zz of a symmetric matrix.
using Symmetric = std::array<double, 6>;

// Of at least one point.
Symmetric covariance(const PointSums& sums);

struct PrincipalAxes {
  // Unit length, of either sign; zero where the spread is least in no single direction.
  std::array<double, 3> least_axis = {0, 0, 0};
  double least = 0, middle = 0, most = 0;  // variances
};

PrincipalAxes principal_axes(const Symmetric& covariance);

}  // namespace segloc
