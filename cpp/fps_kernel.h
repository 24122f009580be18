// Farthest-point sampling of one cloud, or of two at once (one hides the other's latency).
#pragma once

#include "kernels.h"
#include "simd.h"

namespace segloc {
namespace SEGLOC_ISA {
namespace {

constexpr float kFar = 3.402823466e38f;

// The first point whose distance is `value`, the largest one: first its group, then its place.
inline size_t locate(const float* distance, const float* group_max, size_t groups, float value) {
  const Vec target = broadcast(value);
  size_t group = 0;
  for (size_t first = 0; first < groups; first += 64) {
    const size_t last = first + 64 < groups ? first + 64 : groups;
    uint64_t hits = 0;
    for (size_t g = first; g < last; ++g) {
      const uint64_t hit = equal(load(group_max + g * kWidth), target) != 0;
      hits |= hit << (g - first);
    }
    if (hits != 0) {
      group = first + static_cast<size_t>(__builtin_ctzll(hits));
      break;
    }
  }
  distance += group * kFpsGroup;
  uint64_t hits = 0;
  for (size_t i = 0; i < kFpsGroup; i += kWidth) {
    hits |= static_cast<uint64_t>(equal(load(distance + i), target)) << i;
  }
  return group * kFpsGroup + static_cast<size_t>(__builtin_ctzll(hits));
}

inline void reset(const FpsCloud& cloud, size_t n) {
  for (size_t i = 0; i < n; ++i) cloud.distance[i] = kFar;
  for (size_t i = n; i < padded(n, kFpsGroup); ++i) cloud.distance[i] = -1.0f;
}

// The sum is in double and in order, so that every instruction set finds the same centroid.
inline void centroid(const FpsCloud& cloud, size_t n, float (&c)[3]) {
  double sx = 0, sy = 0, sz = 0;
  for (size_t i = 0; i < n; ++i) {
    sx += cloud.x[i];
    sy += cloud.y[i];
    sz += cloud.z[i];
  }
  const double count = static_cast<double>(n);
  c[0] = static_cast<float>(sx / count);
  c[1] = static_cast<float>(sy / count);
  c[2] = static_cast<float>(sz / count);
}

// Takes point c of each cloud into its set; returns the largest distance to the set.
template <int Clouds>
inline void advance(const FpsCloud* const* clouds, size_t groups, const Vec (&cx)[Clouds],
                    const Vec (&cy)[Clouds], const Vec (&cz)[Clouds], float (&farthest)[Clouds]) {
  // Local copies: a vector store could otherwise alias the pointers.
  const float *x[Clouds], *y[Clouds], *z[Clouds];
  float *distance[Clouds], *group_max[Clouds];
  Vec best[Clouds];
  for (int k = 0; k < Clouds; ++k) {
    x[k] = clouds[k]->x;
    y[k] = clouds[k]->y;
    z[k] = clouds[k]->z;
    distance[k] = clouds[k]->distance;
    group_max[k] = clouds[k]->group_max;
    best[k] = broadcast(-1.0f);
  }
  for (size_t g = 0; g < groups; ++g) {
    Vec group[Clouds];
    for (int k = 0; k < Clouds; ++k) group[k] = broadcast(-1.0f);
    for (size_t v = 0; v < kFpsGroup; v += kWidth) {
      const size_t i = g * kFpsGroup + v;
      for (int k = 0; k < Clouds; ++k) {
        const Vec dx = load(x[k] + i) - cx[k];
        const Vec dy = load(y[k] + i) - cy[k];
        const Vec dz = load(z[k] + i) - cz[k];
        const Vec d = min(dx * dx + dy * dy + dz * dz, load(distance[k] + i));
        store(distance[k] + i, d);
        group[k] = max(group[k], d);
      }
    }
    for (int k = 0; k < Clouds; ++k) {
      store(group_max[k] + g * kWidth, group[k]);
      best[k] = max(best[k], group[k]);
    }
  }
  for (int k = 0; k < Clouds; ++k) farthest[k] = reduce_max(best[k]);
}

// Every point that is left coincides with a chosen one: take the others in order.
inline void fill_rest(const FpsCloud& cloud, size_t n, size_t chosen, size_t samples) {
  for (size_t i = 0; i < n; ++i) cloud.distance[i] = 0.0f;
  for (size_t i = 0; i < chosen; ++i) cloud.distance[cloud.order[i]] = 1.0f;
  for (size_t i = 0; i < n && chosen < samples; ++i) {
    if (cloud.distance[i] == 0.0f) cloud.order[chosen++] = static_cast<int32_t>(i);
  }
}

template <int Clouds>
inline void sample(const FpsCloud* const* clouds, size_t n, size_t samples) {
  const size_t groups = padded(n, kFpsGroup) / kFpsGroup;
  Vec cx[Clouds], cy[Clouds], cz[Clouds];
  float farthest[Clouds];
  bool exhausted[Clouds] = {};
  for (int k = 0; k < Clouds; ++k) {
    float c[3];
    centroid(*clouds[k], n, c);
    cx[k] = broadcast(c[0]);
    cy[k] = broadcast(c[1]);
    cz[k] = broadcast(c[2]);
    reset(*clouds[k], n);
  }
  for (size_t s = 0; s < samples; ++s) {
    advance<Clouds>(clouds, groups, cx, cy, cz, farthest);
    for (int k = 0; k < Clouds; ++k) {
      if (exhausted[k]) continue;
      const FpsCloud& cloud = *clouds[k];
      if (!(farthest[k] > 0.0f)) {
        fill_rest(cloud, n, s, samples);
        exhausted[k] = true;
        continue;
      }
      const size_t i = locate(cloud.distance, cloud.group_max, groups, farthest[k]);
      cloud.order[s] = static_cast<int32_t>(i);
      cx[k] = broadcast(cloud.x[i]);
      cy[k] = broadcast(cloud.y[i]);
      cz[k] = broadcast(cloud.z[i]);
      if (s == 0) reset(cloud, n);  // the centroid is no member of the set
    }
  }
}

void fps(const FpsCloud& cloud, size_t n, size_t samples) {
  const FpsCloud* const clouds[1] = {&cloud};
  sample<1>(clouds, n, samples);
}

void fps_pair(const FpsCloud& a, const FpsCloud& b, size_t n, size_t samples) {
  const FpsCloud* const clouds[2] = {&a, &b};
  sample<2>(clouds, n, samples);
}

}  // namespace
}  // namespace SEGLOC_ISA
}  // namespace segloc
