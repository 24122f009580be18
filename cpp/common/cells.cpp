#include "common/cells.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <memory>
#include <numeric>
#include <stdexcept>
#include <utility>

#include "common/portability.h"
#include "simd/kernels.h"

namespace segloc {
namespace {

constexpr int kDigit = 11;
constexpr std::size_t kBuckets = std::size_t{1} << kDigit;

}  // namespace

void radix_sort(std::vector<std::uint64_t>& keys, std::vector<std::uint32_t>& values, int bits) {
  const std::size_t n = keys.size();
  std::vector<std::uint64_t> keys_out(n);
  std::vector<std::uint32_t> values_out(n);
  std::vector<std::size_t> start(kBuckets);
  for (int shift = 0; shift < bits; shift += kDigit) {
    std::fill(start.begin(), start.end(), 0);
    for (const std::uint64_t key : keys) ++start[(key >> shift) & (kBuckets - 1)];
    std::size_t sum = 0;
    for (std::size_t& s : start) {
      const std::size_t count = s;
      s = sum;
      sum += count;
    }
    for (std::size_t i = 0; i < n; ++i) {
      const std::size_t slot = start[(keys[i] >> shift) & (kBuckets - 1)]++;
      keys_out[slot] = keys[i];
      values_out[slot] = values[i];
    }
    keys.swap(keys_out);
    values.swap(values_out);
  }
}

Extent extent_of(const float* points, std::size_t n) {
  float low[kExtentRun], high[kExtentRun];
  const std::size_t runs = 3 * n / kExtentRun;
  if (runs > 0) {
    best_kernels().extent(points, runs, low, high);
  } else {
    for (std::size_t k = 0; k < kExtentRun; ++k) low[k] = high[k] = points[k % 3];
  }
  for (std::size_t i = runs * kExtentRun; i < 3 * n; ++i) {
    low[i % 3] = std::min(low[i % 3], points[i]);
    high[i % 3] = std::max(high[i % 3], points[i]);
  }
  Extent extent;
  for (std::size_t a = 0; a < 3; ++a) {
    for (std::size_t k = a; k < kExtentRun; k += 3) {
      low[a] = std::min(low[a], low[k]);
      high[a] = std::max(high[a], high[k]);
    }
    extent.low[a] = low[a], extent.high[a] = high[a];
  }
  return extent;
}

namespace {

constexpr double kNarrow = 1e9;        // cells from the origin whose numbers fit 32 bits
constexpr std::size_t kChunk = 1024;  // points whose cells are computed at a time, from cache

// How cells are numbered. The lattice is fixed to the frame's origin, not to the cloud: the same
// point always falls into the same cell, whatever else was seen.
struct CellNumbers {
  CellNumbers(const Extent& extent, double edge) : size(edge) {
    std::int64_t first[3], count[3];
    double cells = 1.0;
    for (int a = 0; a < 3; ++a) {
      const double begin = std::floor(extent.low[a] / size);
      const double end = std::floor(extent.high[a] / size);
      const double width = end - begin + 1.0 + 2.0 * CellOrder::kPad;
      cells *= width;
      if (!(std::abs(begin) < 4e18) || !(cells < 4.6e18)) {
        throw std::invalid_argument("the cloud is too large for this cell size");
      }
      first[a] = static_cast<std::int64_t>(begin) - CellOrder::kPad;
      count[a] = static_cast<std::int64_t>(width);
      narrow = narrow && std::abs(begin) < kNarrow && std::abs(end) < kNarrow;
    }
    stride_y = count[0], stride_z = count[0] * count[1];
    const std::uint64_t last = static_cast<std::uint64_t>(stride_z) * count[2] - 1;
    while (bits < 64 && (last >> bits) != 0) ++bits;
    base = static_cast<std::uint64_t>(first[0]) +
           static_cast<std::uint64_t>(first[1]) * static_cast<std::uint64_t>(stride_y) +
           static_cast<std::uint64_t>(first[2]) * static_cast<std::uint64_t>(stride_z);
  }

  // Unsigned: what overflows on the way comes out right.
  std::uint64_t key(std::int64_t x, std::int64_t y, std::int64_t z) const {
    return static_cast<std::uint64_t>(x) +
           static_cast<std::uint64_t>(y) * static_cast<std::uint64_t>(stride_y) +
           static_cast<std::uint64_t>(z) * static_cast<std::uint64_t>(stride_z) - base;
  }

  double size;
  std::int64_t stride_y = 0, stride_z = 0;
  std::uint64_t base = 0;
  int bits = 1;        // of the largest key
  bool narrow = true;  // cells fit 32 bits along each axis
};

// Calls take(points, keys, count) for some points at a time.
template <typename Take>
void each_chunk(const float* points, std::size_t n, const CellNumbers& numbers, Take&& take) {
  const Kernels& kernels = best_kernels();
  std::int32_t cells[3 * kChunk];
  std::uint64_t keys[kChunk];
  for (std::size_t begin = 0; begin < n; begin += kChunk) {
    const std::size_t count = std::min(kChunk, n - begin);
    const float* p = points + 3 * begin;
    if (numbers.narrow) {
      kernels.cell_numbers(p, 3 * count, numbers.size, cells);
      if (numbers.bits <= 32) {
        kernels.cell_keys(cells, count, static_cast<std::uint32_t>(numbers.stride_y),
                          static_cast<std::uint32_t>(numbers.stride_z),
                          static_cast<std::uint32_t>(numbers.base), keys);
      } else {
        for (std::size_t i = 0; i < count; ++i) {
          keys[i] = numbers.key(cells[3 * i], cells[3 * i + 1], cells[3 * i + 2]);
        }
      }
    } else {
      const auto cell = [&](std::size_t k) { return floor_of(p[k] / numbers.size); };
      for (std::size_t i = 0; i < count; ++i) {
        keys[i] = numbers.key(cell(3 * i), cell(3 * i + 1), cell(3 * i + 2));
      }
    }
    take(p, keys, count);
  }
}

// Memory that is written before it is read.
template <typename T>
using Raw = std::unique_ptr<T[]>;
template <typename T>
Raw<T> raw(std::size_t size) {
  return Raw<T>(new T[size]);
}

// Runs of points in one cell, in the order of the input.
struct Runs {
  explicit Runs(std::size_t n) : keys(raw<std::uint64_t>(n)), ends(raw<std::uint32_t>(n)) {}

  std::size_t count = 0;
  Raw<std::uint64_t> keys;
  Raw<std::uint32_t> ends;  // a run begins where the one before ends

  std::uint32_t begin(std::size_t k) const { return k == 0 ? 0 : ends[k - 1]; }
};

SEGLOC_VECTOR(double, Pair, 16);
SEGLOC_VECTOR(std::int64_t, PairMask, 16);

// Sums of the points of a run: x and y, z and their number.
struct RunSum {
  Pair xy, z;

  // To what was summed before, if it is kept: all bits of `kept` are set, or none.
  void add_to(std::int64_t kept, const Pair& more_xy, const Pair& more_z) {
    const PairMask mask = {kept, kept};
    xy = reinterpret_cast<Pair>(reinterpret_cast<PairMask>(xy) & mask) + more_xy;
    z = reinterpret_cast<Pair>(reinterpret_cast<PairMask>(z) & mask) + more_z;
  }
};

// With the sums of each where there is room for them. No branches to guess: runs are short.
Runs find_runs(const float* points, std::size_t n, const CellNumbers& numbers, RunSum* sums) {
  Runs runs(n);
  std::uint64_t last = ~std::uint64_t{0};
  std::uint32_t next = 0;
  RunSum sum{};
  each_chunk(points, n, numbers, [&](const float* p, const std::uint64_t* keys, std::size_t size) {
    std::uint64_t before = last;
    std::uint64_t* run_keys = runs.keys.get();
    std::uint32_t* run_ends = runs.ends.get();
    std::size_t run = runs.count - 1;  // wraps before the first
    if (sums == nullptr) {
      for (std::size_t i = 0; i < size; ++i) {
        run += keys[i] != before;
        before = run_keys[run] = keys[i];
        run_ends[run] = ++next;
      }
    } else {
      RunSum run_sum = sum;
      for (std::size_t i = 0; i < size; ++i, p += 3) {
        const std::int64_t same = -static_cast<std::int64_t>(keys[i] == before);
        run += static_cast<std::size_t>(1 + same);
        before = run_keys[run] = keys[i];
        run_ends[run] = ++next;
        run_sum.add_to(same, Pair{p[0], p[1]}, Pair{p[2], 1.0});
        sums[run] = run_sum;
      }
      sum = run_sum;
    }
    last = before;
    runs.count = run + 1;
  });
  return runs;
}

// Sorts values by their upper 32 bits, of which the lower `bits` are used, stably; the result is in
// either buffer. Of many values a pass costs more than its buckets.
std::uint64_t* sort_packed(std::uint64_t* values, std::uint64_t* buffer, std::size_t n, int bits) {
  constexpr int kWideDigit = 14;
  constexpr std::size_t kMany = std::size_t{1} << 15;
  const int widest = n < kMany ? kDigit : kWideDigit;
  const int digits = (bits + widest - 1) / widest, width = (bits + digits - 1) / digits;
  const std::size_t buckets = std::size_t{1} << width;
  std::vector<std::uint32_t> start(static_cast<std::size_t>(digits) * buckets, 0);
  const auto digit = [=](std::uint64_t value, int d) {
    return (value >> (32 + d * width)) & (buckets - 1);
  };
  for (std::size_t i = 0; i < n; ++i) {
    for (int d = 0; d < digits; ++d) {
      ++start[static_cast<std::size_t>(d) * buckets + digit(values[i], d)];
    }
  }
  for (int d = 0; d < digits; ++d) {
    std::uint32_t* at = start.data() + static_cast<std::size_t>(d) * buckets;
    std::uint32_t sum = 0;
    for (std::size_t k = 0; k < buckets; ++k) sum += std::exchange(at[k], sum);
    for (std::size_t i = 0; i < n; ++i) buffer[at[digit(values[i], d)]++] = values[i];
    std::swap(values, buffer);
  }
  return values;
}

// Calls visit(run, key, a later run) for the runs in the order of their cells, those of a cell as in
// the input.
template <typename Visit>
void in_order(const Runs& runs, int bits, Visit&& visit) {
  constexpr std::size_t kAhead = 16;
  if (runs.count == 0) return;
  const auto later = [&](std::size_t k) { return std::min(k + kAhead, runs.count - 1); };
  if (bits <= 32) {
    const Raw<std::uint64_t> packed = raw<std::uint64_t>(2 * runs.count);
    for (std::size_t k = 0; k < runs.count; ++k) packed[k] = runs.keys[k] << 32 | k;
    const std::uint64_t* sorted =
        sort_packed(packed.get(), packed.get() + runs.count, runs.count, bits);
    for (std::size_t k = 0; k < runs.count; ++k) {
      visit(static_cast<std::uint32_t>(sorted[k]), sorted[k] >> 32,
            static_cast<std::uint32_t>(sorted[later(k)]));
    }
    return;
  }
  std::vector<std::uint64_t> keys(runs.keys.get(), runs.keys.get() + runs.count);
  std::vector<std::uint32_t> order(runs.count);
  std::iota(order.begin(), order.end(), 0u);
  radix_sort(keys, order, bits);
  for (std::size_t k = 0; k < runs.count; ++k) visit(order[k], keys[k], order[later(k)]);
}

CellNumbers numbered(const float* points, std::size_t n, double size) {
  if (!(size > 0.0)) throw std::invalid_argument("cell size must be positive");
  if (n > std::numeric_limits<std::uint32_t>::max()) throw std::invalid_argument("too many points");
  return {n == 0 ? Extent{} : extent_of(points, n), size};
}

}  // namespace

CellRuns sort_into_runs(const float* points, std::size_t n, double size) {
  const CellNumbers numbers = numbered(points, n, size);
  CellRuns cells;
  cells.stride_y = numbers.stride_y, cells.stride_z = numbers.stride_z;
  const Runs runs = find_runs(points, n, numbers, nullptr);
  cells.runs.reserve(runs.count);
  in_order(runs, numbers.bits, [&](std::uint32_t k, std::uint64_t key, std::uint32_t) {
    cells.runs.push_back({key, runs.begin(k), runs.ends[k]});
  });
  return cells;
}

CellOrder sort_into_cells(const float* points, std::size_t n, double size) {
  const CellRuns sorted = sort_into_runs(points, n, size);
  CellOrder cells;
  cells.stride_y = sorted.stride_y, cells.stride_z = sorted.stride_z;
  cells.keys.reserve(n), cells.order.reserve(n);
  for (const CellRun& run : sorted.runs) {
    for (std::uint32_t i = run.begin; i < run.end; ++i) {
      cells.keys.push_back(run.key);
      cells.order.push_back(i);
    }
  }
  return cells;
}

std::vector<std::uint8_t> odd_cells(const float* values, std::size_t count, double size) {
  std::vector<std::uint8_t> odd(count);
  float largest = 0.0f;
  for (std::size_t i = 0; i < count; ++i) largest = std::max(largest, std::abs(values[i]));
  if (!(largest / size < kNarrow)) {
    for (std::size_t i = 0; i < count; ++i) odd[i] = floor_of(values[i] / size) & 1;
    return odd;
  }
  const Kernels& kernels = best_kernels();
  std::int32_t cells[3 * kChunk];
  for (std::size_t begin = 0; begin < count; begin += 3 * kChunk) {
    const std::size_t size_here = std::min(3 * kChunk, count - begin);
    kernels.cell_numbers(values + begin, size_here, size, cells);
    for (std::size_t i = 0; i < size_here; ++i) odd[begin + i] = cells[i] & 1;
  }
  return odd;
}

// Runs are summed on the way: sums of single precision in double are exact, so nothing depends on
// the order.
std::vector<float> voxel_grid(const float* points, std::size_t n, double size) {
  const CellNumbers numbers = numbered(points, n, size);
  const Raw<RunSum> sums = raw<RunSum>(n);
  const Runs runs = find_runs(points, n, numbers, sums.get());
  std::vector<float> means(3 * runs.count);
  std::size_t voxels = 0;
  std::uint64_t cell = ~std::uint64_t{0};
  RunSum sum{};
  in_order(runs, numbers.bits, [&](std::uint32_t k, std::uint64_t key, std::uint32_t later) {
    prefetch(&sums[later]);
    const std::int64_t same = -static_cast<std::int64_t>(key == cell);
    cell = key;
    sum.add_to(same, sums[k].xy, sums[k].z);
    voxels += static_cast<std::size_t>(1 + same);
    const Pair number = {sum.z[1], sum.z[1]}, xy = sum.xy / number, z = sum.z / number;
    float* to = means.data() + 3 * (voxels - 1);
    to[0] = static_cast<float>(xy[0]), to[1] = static_cast<float>(xy[1]);
    to[2] = static_cast<float>(z[0]);
  });
  means.resize(3 * voxels);
  return means;
}

}  // namespace segloc
