// Sums over the pairs of an alignment. The compiler turns the loops over pairs into vectors; what
// they give is added up pair by pair, so that all instruction sets have the same sums.
#pragma once

#include "simd/kernels.h"
#include "simd/simd.h"

namespace segloc {
namespace SEGLOC_ISA {
namespace {

constexpr double kFlat = 1.0 - 1e-3;  // how much less a point is uncertain across its surface
constexpr size_t kPairs = 32;         // that are taken together
constexpr size_t kTogether = 7;       // sums
static_assert(kPairTerms % kTogether == 0, "whole runs of sums");

// Where points are at a pose, and whether they moved as far as their pair holds, or farther.
void move_pairs(const PairArrays& pairs, const double* T, size_t begin, size_t end,
                float* const* moved, uint8_t* lost) {
  const double* R = T;
  const double *sx = pairs.source[0], *sy = pairs.source[1], *sz = pairs.source[2];
  const float *ax = pairs.at[0], *ay = pairs.at[1], *az = pairs.at[2], *stays = pairs.stays;
  float *__restrict mx = moved[0], *__restrict my = moved[1], *__restrict mz = moved[2];
  uint8_t* __restrict far = lost;
  for (size_t i = begin; i < end; ++i) {
    const double x = sx[i], y = sy[i], z = sz[i];
    const auto px = static_cast<float>(R[0] * x + R[1] * y + R[2] * z + T[9]);
    const auto py = static_cast<float>(R[3] * x + R[4] * y + R[5] * z + T[10]);
    const auto pz = static_cast<float>(R[6] * x + R[7] * y + R[8] * z + T[11]);
    const float dx = px - ax[i], dy = py - ay[i], dz = pz - az[i];
    const float by = __builtin_sqrtf(dx * dx + dy * dy + dz * dz);
    mx[i - begin] = px, my[i - begin] = py, mz[i - begin] = pz;
    far[i - begin] = !(by < stays[i]);
  }
}

struct PairError {
  double x, y, z, wx, wy, wz;  // in the frame, and times the weight
  double squared() const { return 0.5 * (x * wx + y * wy + z * wz); }
};

// Of pair i at pose T, in the frame F.
inline PairError error_of(const PairArrays& pairs, const double* F, const double* T, size_t i) {
  const double x = pairs.source[0][i], y = pairs.source[1][i], z = pairs.source[2][i];
  const double ex = pairs.target[0][i] - (T[0] * x + T[1] * y + T[2] * z + T[9]);
  const double ey = pairs.target[1][i] - (T[3] * x + T[4] * y + T[5] * z + T[10]);
  const double ez = pairs.target[2][i] - (T[6] * x + T[7] * y + T[8] * z + T[11]);
  PairError e;
  e.x = F[0] * ex + F[3] * ey + F[6] * ez;
  e.y = F[1] * ex + F[4] * ey + F[7] * ez;
  e.z = F[2] * ex + F[5] * ey + F[8] * ez;
  double* const* W = pairs.weight;
  e.wx = W[0][i] * e.x + W[1][i] * e.y + W[2][i] * e.z;
  e.wy = W[1][i] * e.x + W[3][i] * e.y + W[4][i] * e.z;
  e.wz = W[2][i] * e.x + W[4][i] * e.y + W[5][i] * e.z;
  return e;
}

// The inverse of 2 I - kFlat (n n' + m m') of the two normals, in the frame of T; 0 where there is
// no pair.
inline void weigh_pairs(const PairArrays& pairs, const double* T, size_t begin, size_t end) {
  double *__restrict w0 = pairs.weight[0], *__restrict w1 = pairs.weight[1];
  double *__restrict w2 = pairs.weight[2], *__restrict w3 = pairs.weight[3];
  double *__restrict w4 = pairs.weight[4], *__restrict w5 = pairs.weight[5];
  for (size_t i = begin; i < end; ++i) {
    const double tx = pairs.normal[0][i], ty = pairs.normal[1][i], tz = pairs.normal[2][i];
    const double nx = T[0] * tx + T[3] * ty + T[6] * tz, mx = pairs.own[0][i];
    const double ny = T[1] * tx + T[4] * ty + T[7] * tz, my = pairs.own[1][i];
    const double nz = T[2] * tx + T[5] * ty + T[8] * tz, mz = pairs.own[2][i];
    const double xx = 2.0 - kFlat * (nx * nx + mx * mx), yy = 2.0 - kFlat * (ny * ny + my * my);
    const double zz = 2.0 - kFlat * (nz * nz + mz * mz), xy = -kFlat * (nx * ny + mx * my);
    const double xz = -kFlat * (nx * nz + mx * mz), yz = -kFlat * (ny * nz + my * mz);
    const double a = yy * zz - yz * yz, b = xz * yz - xy * zz, c = xy * yz - xz * yy;
    const double scale = pairs.use[i] / (xx * a + xy * b + xz * c);
    w0[i] = a * scale, w1[i] = b * scale, w2[i] = c * scale;
    w3[i] = (xx * zz - xz * xz) * scale;
    w4[i] = (xy * xz - xx * yz) * scale;
    w5[i] = (xx * yy - xy * xy) * scale;
  }
}

// With J = (skew(s), -I), the error's derivative by a step of rotation and translation: the terms
// of J' W J, its upper triangle by rows, of J' W e, and of the error.
inline void terms_of(const PairArrays& pairs, const double* T, size_t begin, size_t count,
                     double (*__restrict terms)[kPairs]) {
  double* const* W = pairs.weight;
  for (size_t k = 0; k < count; ++k) {
    const size_t i = begin + k;
    const double x = pairs.source[0][i], y = pairs.source[1][i], z = pairs.source[2][i];
    const double xx = W[0][i], xy = W[1][i], xz = W[2][i], yy = W[3][i], yz = W[4][i],
                 zz = W[5][i];
    // W times the columns of skew(s).
    const double ax = xy * z - xz * y, ay = yy * z - yz * y, az = yz * z - zz * y;
    const double bx = xz * x - xx * z, by = yz * x - xy * z, bz = zz * x - xz * z;
    const double cx = xx * y - xy * x, cy = xy * y - yy * x, cz = xz * y - yz * x;
    const PairError e = error_of(pairs, T, T, i);
    terms[0][k] = z * ay - y * az, terms[1][k] = z * by - y * bz, terms[2][k] = z * cy - y * cz;
    terms[3][k] = -ax, terms[4][k] = -ay, terms[5][k] = -az;
    terms[6][k] = x * bz - z * bx, terms[7][k] = x * cz - z * cx;
    terms[8][k] = -bx, terms[9][k] = -by, terms[10][k] = -bz;
    terms[11][k] = y * cx - x * cy;
    terms[12][k] = -cx, terms[13][k] = -cy, terms[14][k] = -cz;
    terms[15][k] = xx, terms[16][k] = xy, terms[17][k] = xz;
    terms[18][k] = yy, terms[19][k] = yz, terms[20][k] = zz;
    terms[21][k] = z * e.wy - y * e.wz;
    terms[22][k] = x * e.wz - z * e.wx;
    terms[23][k] = y * e.wx - x * e.wy;
    terms[24][k] = -e.wx, terms[25][k] = -e.wy, terms[26][k] = -e.wz;
    terms[27][k] = e.squared();
  }
}

void sum_pairs(const PairArrays& pairs, const double* T, size_t begin, size_t end, double* sums) {
  double terms[kPairTerms][kPairs];
  weigh_pairs(pairs, T, begin, end);
  for (size_t at = begin; at < end; at += kPairs) {
    const size_t count = end - at < kPairs ? end - at : kPairs;
    terms_of(pairs, T, at, count, terms);
    for (size_t t = 0; t < kPairTerms; t += kTogether) {  // several: one waits for itself
      double sum[kTogether];
      for (size_t j = 0; j < kTogether; ++j) sum[j] = sums[t + j];
      for (size_t k = 0; k < count; ++k) {
        SEGLOC_UNROLL
        for (size_t j = 0; j < kTogether; ++j) sum[j] += terms[t + j][k];
      }
      for (size_t j = 0; j < kTogether; ++j) sums[t + j] = sum[j];
    }
  }
}

double pair_error(const PairArrays& pairs, const double* F, const double* T, size_t begin,
                  size_t end) {
  double errors[kPairs], sum = 0.0;
  for (size_t at = begin; at < end; at += kPairs) {
    const size_t count = end - at < kPairs ? end - at : kPairs;
    for (size_t k = 0; k < count; ++k) errors[k] = error_of(pairs, F, T, at + k).squared();
    for (size_t k = 0; k < count; ++k) sum += errors[k];
  }
  return sum;
}

}  // namespace
}  // namespace SEGLOC_ISA
}  // namespace segloc
