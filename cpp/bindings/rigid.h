// Rigid transforms from Python.
#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <string>
#include <vector>

#include "bindings/bindings.h"
#include "common/rigid.h"

namespace segloc::bindings {

// Up to rounding.
inline bool is_rotation(const std::array<double, 9>& R) {
  double off = 0.0;
  for (int a = 0; a < 3; ++a) {
    for (int b = 0; b < 3; ++b) {
      const double dot = R[a] * R[b] + R[3 + a] * R[3 + b] + R[6 + a] * R[6 + b];
      off = std::max(off, std::fabs(dot - (a == b ? 1.0 : 0.0)));
    }
  }
  return off < 0.01;
}

// Of a matrix (4, 4), row-major; its last row is not read.
inline Rigid checked_rigid(const double* T, const char* name) {
  require_usable(T, 16, name);
  Rigid result;
  for (std::size_t r = 0; r < 3; ++r) {
    for (std::size_t c = 0; c < 3; ++c) result.R[3 * r + c] = T[4 * r + c];
    result.t[r] = T[4 * r + 3];
  }
  require(is_rotation(result.R), std::string(name) + " does not turn as a rotation does");
  return result;
}

inline Rigid rigid_of(const In2<double>& T, const char* name) {
  require(T.shape(0) == 4 && T.shape(1) == 4, std::string(name) + " must have shape (4, 4)");
  return checked_rigid(T.data(), name);
}

inline std::vector<Rigid> rigids_of(const In3<double>& T, const char* name) {
  require(T.shape(1) == 4 && T.shape(2) == 4, std::string(name) + " must have shape (N, 4, 4)");
  std::vector<Rigid> result(T.shape(0));
  for (std::size_t i = 0; i < result.size(); ++i)
    result[i] = checked_rigid(T.data() + 16 * i, name);
  return result;
}

}  // namespace segloc::bindings
