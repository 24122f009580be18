// Least-squares rigid fits of point pairs.
#pragma once

#include <array>
#include <cstddef>
#include <vector>

namespace segloc {

struct Rigid {
  std::array<double, 9> R{1, 0, 0, 0, 1, 0, 0, 0, 1};  // row-major
  std::array<double, 3> t{0, 0, 0};

  std::array<double, 3> apply(const double* p) const {
    return {R[0] * p[0] + R[1] * p[1] + R[2] * p[2] + t[0],
            R[3] * p[0] + R[4] * p[1] + R[5] * p[2] + t[1],
            R[6] * p[0] + R[7] * p[1] + R[8] * p[2] + t[2]};
  }
};

// Points, (count, 3), by a row-major 4 x 4 transform, in single precision.
std::vector<float> moved_by(const double* T, const float* points, std::size_t count);

// The nearest orthonormal matrix to one that is so but for a hundredth.
std::array<double, 9> orthonormal(std::array<double, 9> R);

// Adds the transform to `values` as a 4 x 4 matrix, row-major.
void append_matrix(const Rigid& T, std::vector<double>& values);

// The transform that takes source[index[i]] closest to target[index[i]] (both (n, 3) row-major).
// Horn's closed form by quaternions (JOSA A, 1987): always a rotation, never a reflection.
Rigid fit_rigid(const double* source, const double* target, const std::vector<std::size_t>& index);

}  // namespace segloc
