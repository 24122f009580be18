// Farthest-point sampling of a few clouds in lockstep: one hides the latency of the others.
#pragma once

#include "kernels.h"
#include "simd.h"

namespace segloc {
namespace SEGLOC_ISA {
namespace {

constexpr float kFar = 3.402823466e38f;
constexpr size_t kLockstep = kRegisters == 32 ? 4 : 2;

// The first of `values` (64 a block) that equals `target`; there is one.
inline size_t first_equal(const float* values, Vec target) {
  for (size_t first = 0;; first += 64) {
    uint64_t hits = 0;
    SEGLOC_UNROLL
    for (size_t i = 0; i < 64; i += kWidth) {
      hits |= static_cast<uint64_t>(equal(load(values + first + i), target)) << i;
    }
    if (hits != 0) return first + static_cast<size_t>(__builtin_ctzll(hits));
  }
}

inline void reset(const FpsCloud& cloud, size_t n) {
  for (size_t i = 0; i < n; ++i) cloud.distance[i] = kFar;
  for (size_t i = n; i < padded(n, kFpsGroup); ++i) cloud.distance[i] = -1.0f;
}

// The sum is in double and in order, so that every instruction set finds the same centroid.
inline void centroid(const FpsCloud& cloud, size_t n, Vec& cx, Vec& cy, Vec& cz) {
  double sx = 0, sy = 0, sz = 0;
  for (size_t i = 0; i < n; ++i) {
    sx += cloud.x[i];
    sy += cloud.y[i];
    sz += cloud.z[i];
  }
  const double count = static_cast<double>(n);
  cx = broadcast(static_cast<float>(sx / count));
  cy = broadcast(static_cast<float>(sy / count));
  cz = broadcast(static_cast<float>(sz / count));
}

// Every point that is left coincides with a chosen one: take the others in order.
inline void fill_rest(const FpsCloud& cloud, size_t n, size_t chosen, size_t samples) {
  for (size_t i = 0; i < n; ++i) cloud.distance[i] = 0.0f;
  for (size_t i = 0; i < chosen; ++i) cloud.distance[cloud.order[i]] = 1.0f;
  for (size_t i = 0; i < n && chosen < samples; ++i) {
    if (cloud.distance[i] == 0.0f) cloud.order[chosen++] = static_cast<int32_t>(i);
  }
}

template <size_t Clouds>
inline void sample(const FpsCloud* clouds, size_t n, size_t samples) {
  const size_t groups = padded(n, kFpsGroup) / kFpsGroup;
  FpsCloud c[Clouds];  // copies: a vector store could alias the pointers otherwise
  Vec cx[Clouds], cy[Clouds], cz[Clouds];
  bool exhausted[Clouds] = {};
  SEGLOC_UNROLL
  for (size_t k = 0; k < Clouds; ++k) {
    c[k] = clouds[k];
    centroid(c[k], n, cx[k], cy[k], cz[k]);
    reset(c[k], n);
    // Groups of padding, so that first_equal can look at whole blocks.
    for (size_t i = groups * kWidth; i < fps_group_max_size(n); ++i) c[k].group_max[i] = -1.0f;
  }
  for (size_t s = 0; s < samples; ++s) {
    // Takes the last point into each set; a group is 64 points and keeps its largest distance.
    Vec best[Clouds];
    SEGLOC_UNROLL
    for (size_t k = 0; k < Clouds; ++k) best[k] = broadcast(-1.0f);
    for (size_t g = 0; g < groups; ++g) {
      SEGLOC_UNROLL
      for (size_t k = 0; k < Clouds; ++k) {
        Vec group = broadcast(-1.0f);
        SEGLOC_UNROLL
        for (size_t v = 0; v < kFpsGroup; v += kWidth) {
          const size_t i = g * kFpsGroup + v;
          const Vec dx = cx[k] - load(c[k].x + i);
          const Vec dy = cy[k] - load(c[k].y + i);
          const Vec dz = cz[k] - load(c[k].z + i);
          const Vec d = min(dx * dx + dy * dy + dz * dz, load(c[k].distance + i));
          store(c[k].distance + i, d);
          group = max(group, d);
        }
        store(c[k].group_max + g * kWidth, group);
        best[k] = max(best[k], group);
      }
    }
    SEGLOC_UNROLL
    for (size_t k = 0; k < Clouds; ++k) {
      if (exhausted[k]) continue;
      const float farthest = reduce_max(best[k]);
      if (!(farthest > 0.0f)) {
        fill_rest(c[k], n, s, samples);
        exhausted[k] = true;
        continue;
      }
      const Vec target = broadcast(farthest);
      const size_t group = first_equal(c[k].group_max, target) / kWidth * kFpsGroup;
      const size_t i = group + first_equal(c[k].distance + group, target);
      c[k].order[s] = static_cast<int32_t>(i);
      cx[k] = broadcast(c[k].x[i]);
      cy[k] = broadcast(c[k].y[i]);
      cz[k] = broadcast(c[k].z[i]);
      if (s == 0) reset(c[k], n);  // the centroid is no member of the set
    }
  }
}

void fps(const FpsCloud* clouds, size_t count, size_t n, size_t samples) {
  size_t i = 0;
  for (; i + kLockstep <= count; i += kLockstep) sample<kLockstep>(clouds + i, n, samples);
  for (; i < count; ++i) sample<1>(clouds + i, n, samples);
}

}  // namespace
}  // namespace SEGLOC_ISA
}  // namespace segloc
