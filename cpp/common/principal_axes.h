// Covariance of points and its principal directions.
#pragma once

#include <array>
#include <cstddef>

namespace segloc {

// xx, xy, xz, yy, yz, zz of a symmetric matrix.
using Symmetric = std::array<double, 6>;

// Sums over points around one of them.
class Moments {
 public:
  void add(const std::array<float, 3>& point, const std::array<float, 3>& centre) {
    const double d[3] = {double{point[0]} - centre[0], double{point[1]} - centre[1],
                         double{point[2]} - centre[2]};
    for (int a = 0; a < 3; ++a) sum_[a] += d[a];
    squares_[0] += d[0] * d[0], squares_[1] += d[0] * d[1], squares_[2] += d[0] * d[2];
    squares_[3] += d[1] * d[1], squares_[4] += d[1] * d[2], squares_[5] += d[2] * d[2];
    ++count_;
  }
  std::size_t count() const { return count_; }
  Symmetric covariance() const;  // of at least one point

 private:
  std::array<double, 3> sum_ = {0, 0, 0};
  Symmetric squares_ = {0, 0, 0, 0, 0, 0};
  std::size_t count_ = 0;
};

struct PrincipalAxes {
  // Unit length, of either sign; zero where the spread is least in no single direction.
  std::array<double, 3> least_axis = {0, 0, 0};
  double least = 0, middle = 0, most = 0;  // variances
};

PrincipalAxes principal_axes(const Symmetric& covariance);

}  // namespace segloc
