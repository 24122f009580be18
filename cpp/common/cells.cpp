#include "common/cells.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <stdexcept>

namespace segloc {

void radix_sort(std::vector<std::uint64_t>& keys, std::vector<std::uint32_t>& values, int bits) {
  constexpr int kDigit = 11;
  constexpr std::size_t kBuckets = std::size_t{1} << kDigit;
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

CellOrder sort_into_cells(const float* points, std::size_t n, double size) {
  if (!(size > 0.0)) throw std::invalid_argument("cell size must be positive");
  if (n > std::numeric_limits<std::uint32_t>::max()) throw std::invalid_argument("too many points");
  CellOrder cells;
  if (n == 0) return cells;

  // The lattice is fixed to the frame's origin, not to the cloud: the same point always falls into
  // the same cell, whatever else was seen.
  std::array<double, 3> low, high;
  low.fill(std::numeric_limits<double>::infinity());
  high.fill(-std::numeric_limits<double>::infinity());
  for (std::size_t i = 0; i < n; ++i) {
    for (int a = 0; a < 3; ++a) {
      const double v = points[3 * i + a];
      low[a] = std::min(low[a], v);
      high[a] = std::max(high[a], v);
    }
  }
  std::array<std::int64_t, 3> first, count;
  double cells_total = 1.0;
  for (int a = 0; a < 3; ++a) {
    const double begin = std::floor(low[a] / size), end = std::floor(high[a] / size);
    const double width = end - begin + 1.0 + 2.0 * CellOrder::kPad;
    cells_total *= width;
    if (!(std::abs(begin) < 4e18) || !(cells_total < 4.6e18)) {
      throw std::invalid_argument("the cloud is too large for this cell size");
    }
    first[a] = static_cast<std::int64_t>(begin) - CellOrder::kPad;
    count[a] = static_cast<std::int64_t>(width);
  }
  cells.stride_y = count[0];
  cells.stride_z = count[0] * count[1];

  cells.keys.resize(n);
  cells.order.resize(n);
  std::uint64_t largest = 0;
  for (std::size_t i = 0; i < n; ++i) {
    std::int64_t c[3];
    for (int a = 0; a < 3; ++a) {
      c[a] = floor_of(points[3 * i + a] / size) - first[a];
    }
    cells.keys[i] =
        static_cast<std::uint64_t>(c[0] + cells.stride_y * c[1] + cells.stride_z * c[2]);
    cells.order[i] = static_cast<std::uint32_t>(i);
    largest = std::max(largest, cells.keys[i]);
  }
  int bits = 1;
  while (bits < 64 && (largest >> bits) != 0) ++bits;
  radix_sort(cells.keys, cells.order, bits);
  return cells;
}

}  // namespace segloc
