// Farthest-point sampling of a few clouds in lockstep: one hides the latency of the others.
#pragma once

#include "simd/kernels.h"
#include "simd/simd.h"

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
    if (hits != 0) return first + lowest_bit(hits);
  }
}

inline void reset(float* distance, size_t n, size_t groups) {
  for (size_t i = 0; i < n; ++i) distance[i] = kFar;
  for (size_t i = n; i < groups * kFpsGroup; ++i) distance[i] = -1.0f;
}

// Nothing is in the set yet. `distance` has those of the points and then those of the groups.
inline void clear_set(float* distance, size_t n, size_t groups) {
  reset(distance, n, groups);
  // Groups of padding, so that first_equal can look at whole blocks.
  float* group_max = distance + groups * kFpsGroup;
  for (size_t i = groups * kWidth; i < fps_group_max_size(groups); ++i) group_max[i] = -1.0f;
}

// The sum is in double and in a fixed order, so that every instruction set finds the same mean. Its
// eight parts let it run at the speed of additions rather than of their latency.
inline float mean(const float* values, size_t n) {
  double parts[8] = {};
  size_t i = 0;
  for (; i + 8 <= n; i += 8) {
    SEGLOC_UNROLL
    for (size_t k = 0; k < 8; ++k) parts[k] += values[i + k];
  }
  for (; i < n; ++i) parts[0] += values[i];
  double sum = 0;
  for (size_t k = 0; k < 8; ++k) sum += parts[k];
  return static_cast<float>(sum / static_cast<double>(n));
}

// Every point that is left coincides with a chosen one: take the others in order.
inline void fill_rest(float* distance, int32_t* order, size_t n, size_t chosen, size_t samples) {
  for (size_t i = 0; i < n; ++i) distance[i] = 0.0f;
  for (size_t i = 0; i < chosen; ++i) distance[order[i]] = 1.0f;
  for (size_t i = 0; i < n && chosen < samples; ++i) {
    if (distance[i] == 0.0f) order[chosen++] = static_cast<int32_t>(i);
  }
}

// `Groups` is the number of groups of 64 points where it is known beforehand, otherwise 0: constant
// offsets leave the registers to the clouds.
template <size_t Clouds, size_t Groups>
inline void sample(const FpsCloud* clouds, size_t most) {
  const size_t groups = Groups ? Groups : most;
  const size_t stride = groups * kFpsGroup;
  float* x[Clouds];  // copies: a vector store could alias the pointers otherwise
  Vec cx[Clouds], cy[Clouds], cz[Clouds];
  size_t left[Clouds], samples = 0;  // still to be chosen of each, and at most
  SEGLOC_UNROLL
  for (size_t k = 0; k < Clouds; ++k) {
    const size_t n = clouds[k].n;
    left[k] = clouds[k].samples;
    samples = left[k] > samples ? left[k] : samples;
    x[k] = clouds[k].memory;
    cx[k] = broadcast(mean(x[k], n));
    cy[k] = broadcast(mean(x[k] + stride, n));
    cz[k] = broadcast(mean(x[k] + 2 * stride, n));
    clear_set(x[k] + 3 * stride, n, groups);
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
          float* p = x[k] + g * kFpsGroup + v;
          const Vec dx = cx[k] - load(p);
          const Vec dy = cy[k] - load(p + stride);
          const Vec dz = cz[k] - load(p + 2 * stride);
          const Vec d = min(dx * dx + dy * dy + dz * dz, load(p + 3 * stride));
          store(p + 3 * stride, d);
          group = max(group, d);
        }
        store(x[k] + 4 * stride + g * kWidth, group);
        best[k] = max(best[k], group);
      }
    }
    SEGLOC_UNROLL
    for (size_t k = 0; k < Clouds; ++k) {
      if (left[k] == 0) continue;
      --left[k];
      const float farthest = reduce_max(best[k]);
      float* distance = x[k] + 3 * stride;
      if (!(farthest > 0.0f)) {
        fill_rest(distance, clouds[k].order, clouds[k].n, s, clouds[k].samples);
        left[k] = 0;
        continue;
      }
      const Vec target = broadcast(farthest);
      const size_t group = first_equal(x[k] + 4 * stride, target) / kWidth * kFpsGroup;
      const size_t i = group + first_equal(distance + group, target);
      clouds[k].order[s] = static_cast<int32_t>(i);
      cx[k] = broadcast(x[k][i]);
      cy[k] = broadcast(x[k][i + stride]);
      cz[k] = broadcast(x[k][i + 2 * stride]);
      if (s == 0) reset(distance, clouds[k].n, groups);  // the centroid is no member of the set
    }
  }
}

// The points of a cloud in cells along a curve, so that those in a row are near each other. Cells
// are halved along their longest side.
class SpatialOrder {
 public:
  static constexpr size_t kHalvings = 9, kCells = size_t{1} << kHalvings;

  SpatialOrder(const float* x, size_t n, size_t stride) : x_(x), n_(n), stride_(stride) {
    float width[3];
    for (size_t d = 0; d < 3; ++d) {
      measure(d);
      width[d] = high_[d] - low_[d];
      parts_[d] = 1;
      for (size_t k = 0; k < kCells; ++k) number_[d][k] = 0;
    }
    for (size_t k = 0; k < kHalvings; ++k) {
      size_t d = width[1] > width[0] ? 1 : 0;
      if (width[2] > width[d]) d = 2;
      for (size_t axis = 0; axis < 3; ++axis) {  // a further digit of the numbers
        for (size_t part = parts_[axis]; part-- > 0;) {
          const auto number = static_cast<uint16_t>(2 * number_[axis][part]);
          if (axis == d) {
            number_[axis][2 * part] = number;
            number_[axis][2 * part + 1] = static_cast<uint16_t>(number + 1);
          } else {
            number_[axis][part] = number;
          }
        }
      }
      parts_[d] *= 2;
      width[d] *= 0.5f;
    }
    for (size_t d = 0; d < 3; ++d) {
      const float whole = high_[d] - low_[d];
      per_metre_[d] = whole > 1e-30f ? static_cast<float>(parts_[d]) / whole : 0.0f;
    }
  }

  // Writes the points in their order, (3, stride), and the row of each; what is behind them repeats
  // the last one.
  void write(float* to, int32_t* rows) const {
    uint32_t start[kCells] = {};
    for (size_t i = 0; i < n_; ++i) {
      const size_t k = cell(i);
      to[i] = static_cast<float>(k);  // until its coordinates are written
      ++start[k];
    }
    uint32_t sum = 0;
    for (size_t k = 0; k < kCells; ++k) {
      const uint32_t count = start[k];
      start[k] = sum;
      sum += count;
    }
    for (size_t i = 0; i < n_; ++i) {
      rows[start[static_cast<size_t>(to[i])]++] = static_cast<int32_t>(i);
    }
    for (size_t d = 0; d < 3; ++d) {
      for (size_t i = 0; i < n_; ++i) to[i + d * stride_] = x_[rows[i] + d * stride_];
      for (size_t i = n_; i < stride_; ++i) to[i + d * stride_] = to[n_ - 1 + d * stride_];
    }
  }

 private:
  void measure(size_t d) {
    const float* values = x_ + d * stride_;
    Vec low = broadcast(values[0]), high = low;
    size_t i = 0;
    for (; i + kWidth <= n_; i += kWidth) {
      const Vec v = load(values + i);
      low = min(v, low), high = max(v, high);
    }
    low_[d] = -reduce_max(broadcast(0.0f) - low), high_[d] = reduce_max(high);
    for (; i < n_; ++i) {
      low_[d] = values[i] < low_[d] ? values[i] : low_[d];
      high_[d] = values[i] > high_[d] ? values[i] : high_[d];
    }
  }

  size_t cell(size_t i) const {
    size_t number = 0;
    for (size_t d = 0; d < 3; ++d) {
      const auto part = static_cast<size_t>((x_[i + d * stride_] - low_[d]) * per_metre_[d]);
      number |= number_[d][part < parts_[d] ? part : parts_[d] - 1];
    }
    return number;
  }

  const float* x_;
  size_t n_, stride_, parts_[3];
  float low_[3], high_[3], per_metre_[3];
  uint16_t number_[3][kCells];
};

// Groups of 64 points with their boxes: what is farther from a box than the points in it are from
// the set changes none of them.
class Boxes {
 public:
  // Of whole groups of points. `memory` has 7 values a group, padded to 64 each.
  Boxes(const float* x, size_t groups, float* memory)
      : groups_(groups), padded_(padded(groups, 64)), farthest_(memory) {
    reset();
    for (size_t g = groups; g < padded_; ++g) farthest_[g] = -1.0f;
    for (size_t d = 0; d < 3; ++d) {
      for (size_t g = 0; g < groups; ++g) {
        const float* values = x + (d * groups + g) * kFpsGroup;
        Vec low = load(values), high = low;
        SEGLOC_UNROLL
        for (size_t v = kWidth; v < kFpsGroup; v += kWidth) {
          low = min(low, load(values + v)), high = max(high, load(values + v));
        }
        side(2 * d)[g] = -reduce_max(broadcast(0.0f) - low);
        side(2 * d + 1)[g] = reduce_max(high);
      }
      for (size_t g = groups; g < padded_; ++g) side(2 * d)[g] = kFar, side(2 * d + 1)[g] = -kFar;
    }
  }

  // Calls update(group) for the groups that a point may be nearer to than the set is.
  template <typename Update>
  void each_near(const float* place, Update&& update) {
    const Vec zero = broadcast(0.0f), margin = broadcast(1.0f - 1e-5f);  // for rounding
    for (size_t first = 0; first < groups_; first += kWidth) {
      Vec squared = zero;
      for (size_t d = 0; d < 3; ++d) {
        const Vec at = broadcast(place[d]);
        const Vec low = load(side(2 * d) + first) - at, high = at - load(side(2 * d + 1) + first);
        const Vec gap = max(max(low, high), zero);
        squared = squared + gap * gap;
      }
      uint32_t hits = less_equal(squared * margin, load(farthest_ + first));
      for (; hits != 0; hits &= hits - 1) {
        const size_t g = first + lowest_bit(hits);
        if (g < groups_) farthest_[g] = update(g);
      }
    }
  }

  float farthest() const {
    Vec most = load(farthest_);
    for (size_t g = kWidth; g < padded_; g += kWidth) most = max(most, load(farthest_ + g));
    return reduce_max(most);
  }
  // Calls visit(group) for the groups whose farthest point is at this distance.
  template <typename Visit>
  void each_at(float distance, Visit&& visit) const {
    const Vec target = broadcast(distance);
    for (size_t first = 0; first < groups_; first += kWidth) {
      for (uint32_t hits = equal(load(farthest_ + first), target); hits != 0; hits &= hits - 1) {
        visit(first + lowest_bit(hits));
      }
    }
  }
  void reset() {
    for (size_t g = 0; g < groups_; ++g) farthest_[g] = kFar;
  }

 private:
  float* side(size_t k) const { return farthest_ + (k + 1) * padded_; }

  size_t groups_, padded_;
  float* farthest_;  // distance to the set of the farthest point of each group
};

// The place of the point whose row is the lowest of those at the farthest distance.
inline size_t first_farthest(const Boxes& boxes, const float* distance, const int32_t* rows,
                             float farthest) {
  const Vec target = broadcast(farthest);
  size_t found = 0;
  int32_t least = 0x7fffffff;
  boxes.each_at(farthest, [&](size_t g) {
    for (size_t v = g * kFpsGroup; v < (g + 1) * kFpsGroup; v += kWidth) {
      for (uint32_t hits = equal(load(distance + v), target); hits != 0; hits &= hits - 1) {
        const size_t i = v + lowest_bit(hits);
        if (rows[i] < least) least = rows[i], found = i;
      }
    }
  });
  return found;
}

// Of a large cloud most points are far from the last one that was taken: only the groups near it
// are looked at. Points near each other share a group.
void sample_large(const FpsCloud& cloud, size_t groups) {
  const size_t n = cloud.n, stride = groups * kFpsGroup;
  float* distance = cloud.memory + 3 * stride;
  float* x = cloud.memory + 4 * stride;
  auto* rows = reinterpret_cast<int32_t*>(x + 3 * stride);
  SpatialOrder(cloud.memory, n, stride).write(x, rows);
  Boxes boxes(x, groups, x + 4 * stride);
  float place[3];
  for (size_t d = 0; d < 3; ++d) place[d] = mean(cloud.memory + d * stride, n);
  reset(distance, n, groups);
  for (size_t s = 0; s < cloud.samples; ++s) {
    const Vec cx = broadcast(place[0]), cy = broadcast(place[1]), cz = broadcast(place[2]);
    boxes.each_near(place, [&](size_t g) {
      Vec most = broadcast(-1.0f);
      SEGLOC_UNROLL
      for (size_t v = 0; v < kFpsGroup; v += kWidth) {
        float* p = x + g * kFpsGroup + v;
        float* to = distance + g * kFpsGroup + v;
        const Vec dx = cx - load(p), dy = cy - load(p + stride), dz = cz - load(p + 2 * stride);
        const Vec d = min(dx * dx + dy * dy + dz * dz, load(to));
        store(to, d);
        most = max(most, d);
      }
      return reduce_max(most);
    });
    const float farthest = boxes.farthest();
    if (!(farthest > 0.0f)) return fill_rest(distance, cloud.order, n, s, cloud.samples);
    const size_t i = first_farthest(boxes, distance, rows, farthest);
    cloud.order[s] = rows[i];
    for (size_t d = 0; d < 3; ++d) place[d] = x[i + d * stride];
    if (s == 0) {  // the centroid is no member of the set
      reset(distance, n, groups);
      boxes.reset();
    }
  }
}

template <size_t Groups>
void fps_of(const FpsCloud* clouds, size_t count, size_t groups) {
  size_t i = 0;
  for (; i + kLockstep <= count; i += kLockstep) sample<kLockstep, Groups>(clouds + i, groups);
  for (; i < count; ++i) sample<1, Groups>(clouds + i, groups);
}

void fps(const FpsCloud* clouds, size_t count, size_t groups) {
  if (groups > kFpsFewGroups) {
    for (size_t k = 0; k < count; ++k) sample_large(clouds[k], groups);
    return;
  }
  switch (groups) {
    case 1:
      return fps_of<1>(clouds, count, groups);
    case 2:
      return fps_of<2>(clouds, count, groups);
    case 4:
      return fps_of<4>(clouds, count, groups);
    default:
      return fps_of<0>(clouds, count, groups);
  }
}

}  // namespace
}  // namespace SEGLOC_ISA
}  // namespace segloc
