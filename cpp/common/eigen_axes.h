// Eigenvectors of symmetric matrices of three rows.
#pragma once

#include <array>

namespace segloc {

using Vec3 = std::array<double, 3>;
using Mat3 = std::array<Vec3, 3>;

struct EigenAxes {
  Mat3 axes;    // rows are unit eigenvectors
  Vec3 values;  // their eigenvalues, falling
};

// Of a symmetric matrix without negative eigenvalues, by cyclic Jacobi rotations.
EigenAxes eigen_axes(Mat3 matrix);

}  // namespace segloc
