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

namespace {

constexpr std::size_t kChunk = 1024;  // points whose cells are computed at a time, from cache

struct Bounds {
  double low[3], high[3];
};

// Of n > 0 points.
Bounds bounds_of(const float* points, std::size_t n) {
  constexpr std::size_t kWide = 12;  // four points: whole vectors
  float low[kWide], high[kWide];
  for (std::size_t k = 0; k < kWide; ++k) low[k] = high[k] = points[k % 3];
  std::size_t i = 0;
  for (; i + kWide <= 3 * n; i += kWide) {
    for (std::size_t k = 0; k < kWide; ++k) {
      low[k] = std::min(low[k], points[i + k]);
      high[k] = std::max(high[k], points[i + k]);
    }
  }
  for (; i < 3 * n; ++i) {
    low[i % 3] = std::min(low[i % 3], points[i]);
    high[i % 3] = std::max(high[i % 3], points[i]);
  }
  Bounds bounds;
  for (std::size_t a = 0; a < 3; ++a) {
    bounds.low[a] = std::min({low[a], low[a + 3], low[a + 6], low[a + 9]});
    bounds.high[a] = std::max({high[a], high[a + 3], high[a + 6], high[a + 9]});
  }
  return bounds;
}

// How cells are numbered. The lattice is fixed to the frame's origin, not to the cloud: the same
// point always falls into the same cell, whatever else was seen.
struct CellNumbers {
  CellNumbers(const Bounds& bounds, double edge) : size(edge) {
    std::int64_t first[3], count[3];
    double cells = 1.0;
    for (int a = 0; a < 3; ++a) {
      const double begin = std::floor(bounds.low[a] / size);
      const double end = std::floor(bounds.high[a] / size);
      const double width = end - begin + 1.0 + 2.0 * CellOrder::kPad;
      cells *= width;
      if (!(std::abs(begin) < 4e18) || !(cells < 4.6e18)) {
        throw std::invalid_argument("the cloud is too large for this cell size");
      }
      first[a] = static_cast<std::int64_t>(begin) - CellOrder::kPad;
      count[a] = static_cast<std::int64_t>(width);
      narrow = narrow && std::abs(begin) < 1e9 && std::abs(end) < 1e9;
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

// Calls take(point, key) for each point in turn.
template <typename Take>
void each_key(const float* points, std::size_t n, const CellNumbers& numbers, Take&& take) {
  if (!numbers.narrow) {
    for (const float* p = points; p < points + 3 * n; p += 3) {
      std::int64_t cell[3];
      for (int a = 0; a < 3; ++a) cell[a] = floor_of(p[a] / numbers.size);
      take(p, numbers.key(cell[0], cell[1], cell[2]));
    }
    return;
  }
  const Kernels& kernels = best_kernels();
  std::int32_t cells[3 * kChunk];
  for (std::size_t begin = 0; begin < n; begin += kChunk) {
    const std::size_t count = 3 * std::min(kChunk, n - begin);
    const float* p = points + 3 * begin;
    kernels.cell_numbers(p, count, numbers.size, cells);
    for (std::size_t i = 0; i < count; i += 3) {
      take(p + i, numbers.key(cells[i], cells[i + 1], cells[i + 2]));
    }
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

// Calls also(point, run, whether it is the first of the run).
template <typename Also>
Runs find_runs(const float* points, std::size_t n, const CellNumbers& numbers, Also&& also) {
  Runs runs(n);
  std::uint64_t last = ~std::uint64_t{0};
  std::uint32_t next = 0;
  each_key(points, n, numbers, [&](const float* p, std::uint64_t key) {  // no branch to guess
    const bool fresh = key != last;
    runs.count += fresh;
    last = key;
    runs.keys[runs.count - 1] = key;
    runs.ends[runs.count - 1] = ++next;
    also(p, runs.count - 1, fresh);
  });
  return runs;
}

// Sorts values by their upper 32 bits, stably; the result is in either buffer.
std::uint64_t* sort_packed(std::uint64_t* values, std::uint64_t* buffer, std::size_t n, int bits) {
  constexpr int kDigits = 3;
  std::vector<std::uint32_t> start(kDigits * kBuckets, 0);
  const int digits = (bits + kDigit - 1) / kDigit;
  const auto digit = [](std::uint64_t value, int d) {
    return (value >> (32 + d * kDigit)) & (kBuckets - 1);
  };
  for (std::size_t i = 0; i < n; ++i) {
    for (int d = 0; d < kDigits; ++d) ++start[d * kBuckets + digit(values[i], d)];
  }
  for (int d = 0; d < digits; ++d) {
    std::uint32_t* at = start.data() + d * kBuckets;
    std::uint32_t sum = 0;
    for (std::size_t k = 0; k < kBuckets; ++k) sum += std::exchange(at[k], sum);
    for (std::size_t i = 0; i < n; ++i) buffer[at[digit(values[i], d)]++] = values[i];
    std::swap(values, buffer);
  }
  return values;
}

// Calls visit(run, key) for the runs in the order of their cells, those of a cell as in the input.
template <typename Visit>
void in_order(const Runs& runs, int bits, Visit&& visit) {
  if (bits <= 32) {
    const Raw<std::uint64_t> packed = raw<std::uint64_t>(2 * runs.count);
    for (std::size_t k = 0; k < runs.count; ++k) packed[k] = runs.keys[k] << 32 | k;
    const std::uint64_t* sorted =
        sort_packed(packed.get(), packed.get() + runs.count, runs.count, bits);
    for (std::size_t k = 0; k < runs.count; ++k) {
      visit(static_cast<std::uint32_t>(sorted[k]), sorted[k] >> 32);
    }
    return;
  }
  std::vector<std::uint64_t> keys(runs.keys.get(), runs.keys.get() + runs.count);
  std::vector<std::uint32_t> order(runs.count);
  std::iota(order.begin(), order.end(), 0u);
  radix_sort(keys, order, bits);
  for (std::size_t k = 0; k < runs.count; ++k) visit(order[k], keys[k]);
}

CellNumbers numbered(const float* points, std::size_t n, double size) {
  if (!(size > 0.0)) throw std::invalid_argument("cell size must be positive");
  if (n > std::numeric_limits<std::uint32_t>::max()) throw std::invalid_argument("too many points");
  return {n == 0 ? Bounds{} : bounds_of(points, n), size};
}

SEGLOC_VECTOR(double, Pair, 16);
SEGLOC_VECTOR(std::int64_t, PairMask, 16);

// Sums of the points of a run.
struct RunSum {
  Pair xy, z;
};

}  // namespace

CellRuns sort_into_runs(const float* points, std::size_t n, double size) {
  const CellNumbers numbers = numbered(points, n, size);
  CellRuns cells;
  cells.stride_y = numbers.stride_y, cells.stride_z = numbers.stride_z;
  const Runs runs = find_runs(points, n, numbers, [](const float*, std::size_t, bool) {});
  cells.runs.reserve(runs.count);
  in_order(runs, numbers.bits, [&](std::uint32_t k, std::uint64_t key) {
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

// Runs are summed on the way: sums of single precision in double are exact, so nothing depends on
// the order.
std::vector<float> voxel_grid(const float* points, std::size_t n, double size) {
  const CellNumbers numbers = numbered(points, n, size);
  const Raw<RunSum> sums = raw<RunSum>(n);
  Pair xy = {0.0, 0.0}, z = {0.0, 0.0};
  const Runs runs = find_runs(points, n, numbers, [&](const float* p, std::size_t k, bool fresh) {
    const std::int64_t kept = fresh ? 0 : -1;
    const PairMask mask = {kept, kept};
    xy = reinterpret_cast<Pair>(reinterpret_cast<PairMask>(xy) & mask) + Pair{p[0], p[1]};
    z = reinterpret_cast<Pair>(reinterpret_cast<PairMask>(z) & mask) + Pair{p[2], 1.0};
    sums[k] = {xy, z};
  });
  std::vector<float> means;
  means.reserve(3 * runs.count);
  std::uint64_t cell = ~std::uint64_t{0};
  RunSum sum{};
  const auto write = [&] {
    for (const double each : {sum.xy[0], sum.xy[1], sum.z[0]}) {
      means.push_back(static_cast<float>(each / sum.z[1]));
    }
  };
  in_order(runs, numbers.bits, [&](std::uint32_t k, std::uint64_t key) {
    if (key == cell) {
      sum.xy += sums[k].xy, sum.z += sums[k].z;
      return;
    }
    if (sum.z[1] > 0.0) write();
    sum = sums[k], cell = key;
  });
  if (sum.z[1] > 0.0) write();
  return means;
}

}  // namespace segloc
