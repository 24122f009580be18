// Statistics of kSortLanes clouds side by side, a lane each.
#pragma once

#include "simd/kernels.h"
#include "simd/simd.h"

namespace segloc {
namespace SEGLOC_ISA {
namespace {

// Exchanges between 2^Depth rows that lie `step` rows apart: first those of the halves, and at last
// those of neighbours.
template <size_t Depth, bool Falls>
inline void exchange(float* rows, size_t step) {
  constexpr size_t kRows = size_t{1} << Depth;
  SEGLOC_UNROLL
  for (size_t lane = 0; lane < kSortLanes; lane += kWidth) {
    Vec v[kRows];
    SEGLOC_UNROLL
    for (size_t i = 0; i < kRows; ++i) v[i] = load(rows + kSortLanes * step * i + lane);
    SEGLOC_UNROLL
    for (size_t apart = kRows / 2; apart > 0; apart /= 2) {
      SEGLOC_UNROLL
      for (size_t i = 0; i < kRows; ++i) {
        if ((i & apart) != 0) continue;
        const size_t low = Falls ? i + apart : i, high = Falls ? i : i + apart;
        const Vec one = v[low], other = v[high];
        v[low] = min(one, other);
        v[high] = max(one, other);
      }
    }
    SEGLOC_UNROLL
    for (size_t i = 0; i < kRows; ++i) store(rows + kSortLanes * step * i + lane, v[i]);
  }
}

// Steps of a bitonic merge that are done at once, from registers: those from 2^(Depth - 1) * step
// down to `step`.
template <size_t Depth>
inline void merge_steps(float* rows, size_t count, size_t run, size_t step) {
  for (size_t begin = 0; begin < count; begin += step << Depth) {
    for (size_t i = begin; i < begin + step; ++i) {
      if ((begin & run) != 0) {
        exchange<Depth, true>(rows + kSortLanes * i, step);
      } else {
        exchange<Depth, false>(rows + kSortLanes * i, step);
      }
    }
  }
}

// A bitonic network, which takes no branches: several times faster than one list after another.
void sort_lanes(float* rows, size_t count) {
  size_t depth = 1;  // of the run
  for (size_t run = 2; run <= count; run *= 2, ++depth) {
    const size_t rest = depth % 3;
    if (rest == 1) merge_steps<1>(rows, count, run, size_t{1} << (depth - 1));
    if (rest == 2) merge_steps<2>(rows, count, run, size_t{1} << (depth - 2));
    for (size_t left = depth - rest; left > 0; left -= 3) {
      merge_steps<3>(rows, count, run, size_t{1} << (left - 3));
    }
  }
}

// Loops over lanes become vector instructions.
void axis_statistics(const float* rows, size_t count, AxisLanes& axis) {
  float low[kSortLanes], high[kSortLanes];
  double sum[kSortLanes] = {}, squares[kSortLanes] = {};
  for (size_t lane = 0; lane < kSortLanes; ++lane) low[lane] = high[lane] = rows[lane];
  for (size_t i = 0; i < count; ++i) {
    const float* row = rows + kSortLanes * i;
    for (size_t lane = 0; lane < kSortLanes; ++lane) {
      low[lane] = row[lane] < low[lane] ? row[lane] : low[lane];
      high[lane] = high[lane] < row[lane] ? row[lane] : high[lane];
      sum[lane] += static_cast<double>(row[lane]);
    }
  }
  const auto n = static_cast<double>(count);
  for (size_t lane = 0; lane < kSortLanes; ++lane) sum[lane] /= n;  // the means
  for (size_t i = 0; i < count; ++i) {
    const float* row = rows + kSortLanes * i;
    for (size_t lane = 0; lane < kSortLanes; ++lane) {
      const double off = static_cast<double>(row[lane]) - sum[lane];
      squares[lane] += off * off;
    }
  }
  for (size_t lane = 0; lane < kSortLanes; ++lane) {
    axis.low[lane] = low[lane], axis.high[lane] = high[lane];
    axis.mean[lane] = static_cast<float>(sum[lane]);
    axis.spread[lane] = static_cast<float>(__builtin_sqrt(squares[lane] / n));
  }
}

void pair_distances(const float* const* xyz, size_t count, float* space, float* flat, float* rise) {
  for (size_t i = 0; i < count; ++i) {
    for (size_t j = 0; j < i; ++j) {
      const float *ax = xyz[0] + kSortLanes * i, *bx = xyz[0] + kSortLanes * j;
      const float *ay = xyz[1] + kSortLanes * i, *by = xyz[1] + kSortLanes * j;
      const float *az = xyz[2] + kSortLanes * i, *bz = xyz[2] + kSortLanes * j;
      SEGLOC_UNROLL
      for (size_t lane = 0; lane < kSortLanes; lane += kWidth) {
        const Vec dx = load(ax + lane) - load(bx + lane), dy = load(ay + lane) - load(by + lane);
        const Vec dz = load(az + lane) - load(bz + lane);
        const Vec level = dx * dx + dy * dy;
        store(flat + lane, level);
        store(space + lane, level + dz * dz);
        store(rise + lane, max(dz, broadcast(0.0f) - dz));
      }
      space += kSortLanes, flat += kSortLanes, rise += kSortLanes;
    }
  }
}

// The slice that each point lies in, as a number.
inline void number_slices(const SliceTask& task, float* number) {
  const auto slices = static_cast<float>(task.slices);
  for (size_t lane = 0; lane < kSortLanes; lane += kWidth) {
    const Vec low = load(task.low + lane), span = load(task.span + lane);
    for (size_t i = 0; i < task.count; ++i) {
      const Vec at = (load(task.along + kSortLanes * i + lane) - low) / span * broadcast(slices);
      Vec slice = broadcast(0.0f);
      for (size_t k = 1; k < task.slices; ++k) {
        slice = count_not_above(slice, broadcast(static_cast<float>(k)), at);
      }
      store(number + kSortLanes * i + lane, slice);
    }
  }
}

void slice_sums(const SliceTask& task, float* number, SliceLanes* sums) {
  number_slices(task, number);
  const Vec zero = broadcast(0.0f), lowest = broadcast(-3.402823466e38f);
  for (size_t k = 0; k < task.slices; ++k) {
    const Vec wanted = broadcast(static_cast<float>(k));
    for (size_t lane = 0; lane < kSortLanes; lane += kWidth) {
      const Vec mean_a = load(task.means[0] + lane), mean_b = load(task.means[1] + lane);
      Vec count = zero, a_sum = zero, b_sum = zero, a_squares = zero, b_squares = zero;
      Vec top = lowest;
      for (size_t i = lane; i < kSortLanes * task.count; i += kSortLanes) {
        const Vec slice = load(number + i);
        const Vec a = choose_equal(slice, wanted, load(task.values[0] + i) - mean_a, zero);
        const Vec off = load(task.values[1] + i) - mean_b;
        const Vec b = choose_equal(slice, wanted, off, zero);
        count = count + choose_equal(slice, wanted, broadcast(1.0f), zero);
        a_sum = a_sum + a, b_sum = b_sum + b;
        a_squares = a_squares + a * a, b_squares = b_squares + b * b;
        top = max(choose_equal(slice, wanted, off, lowest), top);
      }
      store(sums[k].count + lane, count);
      store(sums[k].sum[0] + lane, a_sum), store(sums[k].sum[1] + lane, b_sum);
      store(sums[k].squares[0] + lane, a_squares), store(sums[k].squares[1] + lane, b_squares);
      store(sums[k].top + lane, top);
    }
  }
}

}  // namespace
}  // namespace SEGLOC_ISA
}  // namespace segloc
