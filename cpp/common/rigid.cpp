#include "common/rigid.h"

#include <cmath>

namespace segloc {
namespace {

using Matrix4 = std::array<std::array<double, 4>, 4>;

// Eigenvector of the largest eigenvalue of a symmetric matrix, by cyclic Jacobi rotations.
std::array<double, 4> principal_axis(Matrix4 a) {
  Matrix4 v{};
  for (int i = 0; i < 4; ++i) v[i][i] = 1.0;
  for (int sweep = 0; sweep < 30; ++sweep) {
    double off = 0.0;
    for (int p = 0; p < 4; ++p) {
      for (int q = p + 1; q < 4; ++q) off += a[p][q] * a[p][q];
    }
    if (off < 1e-300) break;
    for (int p = 0; p < 4; ++p) {
      for (int q = p + 1; q < 4; ++q) {
        if (a[p][q] == 0.0) continue;
        const double theta = (a[q][q] - a[p][p]) / (2.0 * a[p][q]);
        const double t =
            (theta >= 0 ? 1.0 : -1.0) / (std::fabs(theta) + std::sqrt(theta * theta + 1.0));
        const double c = 1.0 / std::sqrt(t * t + 1.0), s = t * c;
        for (int k = 0; k < 4; ++k) {
          const double kp = a[k][p], kq = a[k][q];
          a[k][p] = c * kp - s * kq;
          a[k][q] = s * kp + c * kq;
        }
        for (int k = 0; k < 4; ++k) {
          const double pk = a[p][k], qk = a[q][k];
          a[p][k] = c * pk - s * qk;
          a[q][k] = s * pk + c * qk;
          const double vp = v[k][p], vq = v[k][q];
          v[k][p] = c * vp - s * vq;
          v[k][q] = s * vp + c * vq;
        }
      }
    }
  }
  int best = 0;
  for (int i = 1; i < 4; ++i) {
    if (a[i][i] > a[best][best]) best = i;
  }
  return {v[0][best], v[1][best], v[2][best], v[3][best]};
}

std::array<double, 9> rotation_of(const std::array<double, 4>& q) {
  const double w = q[0], x = q[1], y = q[2], z = q[3];
  return {1 - 2 * (y * y + z * z), 2 * (x * y - w * z),     2 * (x * z + w * y),
          2 * (x * y + w * z),     1 - 2 * (x * x + z * z), 2 * (y * z - w * x),
          2 * (x * z - w * y),     2 * (y * z + w * x),     1 - 2 * (x * x + y * y)};
}

std::array<double, 9> best_rotation(const double S[3][3]) {
  const Matrix4 N = {{
      {S[0][0] + S[1][1] + S[2][2], S[1][2] - S[2][1], S[2][0] - S[0][2], S[0][1] - S[1][0]},
      {S[1][2] - S[2][1], S[0][0] - S[1][1] - S[2][2], S[0][1] + S[1][0], S[2][0] + S[0][2]},
      {S[2][0] - S[0][2], S[0][1] + S[1][0], -S[0][0] + S[1][1] - S[2][2], S[1][2] + S[2][1]},
      {S[0][1] - S[1][0], S[2][0] + S[0][2], S[1][2] + S[2][1], -S[0][0] - S[1][1] + S[2][2]},
  }};
  return rotation_of(principal_axis(N));
}

}  // namespace

std::vector<float> moved_by(const double* T, const float* points, std::size_t count) {
  std::vector<float> moved(3 * count);
  for (std::size_t i = 0; i < 3 * count; i += 3) {
    const double x = points[i], y = points[i + 1], z = points[i + 2];
    moved[i] = static_cast<float>(T[0] * x + T[1] * y + T[2] * z + T[3]);
    moved[i + 1] = static_cast<float>(T[4] * x + T[5] * y + T[6] * z + T[7]);
    moved[i + 2] = static_cast<float>(T[8] * x + T[9] * y + T[10] * z + T[11]);
  }
  return moved;
}

// Newton's iteration for the polar decomposition: each squares what is left.
std::array<double, 9> orthonormal(std::array<double, 9> R) {
  for (int step = 0; step < 4; ++step) {
    const auto dot = [&](int a, int b) {
      return R[a] * R[b] + R[3 + a] * R[3 + b] + R[6 + a] * R[6 + b];
    };
    const double xx = dot(0, 0), yy = dot(1, 1), zz = dot(2, 2);
    const double xy = dot(0, 1), xz = dot(0, 2), yz = dot(1, 2);
    for (int r = 0; r < 9; r += 3) {
      const double x = R[r], y = R[r + 1], z = R[r + 2];
      R[r] = 1.5 * x - 0.5 * (x * xx + y * xy + z * xz);
      R[r + 1] = 1.5 * y - 0.5 * (x * xy + y * yy + z * yz);
      R[r + 2] = 1.5 * z - 0.5 * (x * xz + y * yz + z * zz);
    }
  }
  return R;
}

void append_matrix(const Rigid& T, std::vector<double>& values) {
  for (std::size_t r = 0; r < 3; ++r) {
    values.insert(values.end(), {T.R[3 * r], T.R[3 * r + 1], T.R[3 * r + 2], T.t[r]});
  }
  values.insert(values.end(), {0, 0, 0, 1});
}

Rigid fit_rigid(const double* source, const double* target, const std::vector<std::size_t>& index) {
  double a[3] = {0, 0, 0}, b[3] = {0, 0, 0};
  for (const std::size_t i : index) {
    for (int k = 0; k < 3; ++k) {
      a[k] += source[3 * i + k] / double(index.size());
      b[k] += target[3 * i + k] / double(index.size());
    }
  }
  double S[3][3] = {};  // S[r][c] = sum of source_r * target_c, both centred
  for (const std::size_t i : index) {
    for (int r = 0; r < 3; ++r) {
      for (int c = 0; c < 3; ++c)
        S[r][c] += (source[3 * i + r] - a[r]) * (target[3 * i + c] - b[c]);
    }
  }
  Rigid T;
  T.R = best_rotation(S);
  const auto moved = T.apply(a);
  for (int k = 0; k < 3; ++k) T.t[k] = b[k] - moved[k];
  return T;
}

}  // namespace segloc
