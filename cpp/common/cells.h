// A cloud sorted into cubic cells, for voxel grids, clustering and nearest points.
#pragma once

#include <cstddef>
#include <cstdint>
#include <vector>

namespace segloc {

// Of what fits 62 bits; std::floor is a call without SSE4.1.
inline std::int64_t floor_of(double v) {
  const auto whole = static_cast<std::int64_t>(v);
  return whole - (v < static_cast<double>(whole));
}

struct Extent {
  double low[3], high[3];
};

// Of n > 0 points, (n, 3) row-major.
Extent extent_of(const float* points, std::size_t n);

// Points in the order of their cell keys. Keys run fastest along x and are padded by `kPad` cells
// on every side, so that the key of a neighbour cell is the cell's own key plus a constant.
struct CellOrder {
  static constexpr std::int64_t kPad = 2;

  std::vector<std::uint32_t> order;  // point indices; ties keep the order of the input
  std::vector<std::uint64_t> keys;   // keys[i] belongs to order[i]; never falls
  std::int64_t stride_y = 0;         // key difference of a step along y
  std::int64_t stride_z = 0;
};

// Points begin .. end of the input, which all lie in one cell.
struct CellRun {
  std::uint64_t key;
  std::uint32_t begin, end;
};

// The same, run by run: neighbours in a scan, or in a voxel grid, mostly share their cell.
struct CellRuns {
  std::vector<CellRun> runs;  // keys never fall; those of one cell keep the order of the input
  std::int64_t stride_y = 0, stride_z = 0;
};

// Sorts n finite points, (n, 3) row-major, into cells of edge `size` metres.
// Throws std::invalid_argument if size is not positive or the cells cannot be numbered in 62 bits.
CellRuns sort_into_runs(const float* points, std::size_t n, double size);
CellOrder sort_into_cells(const float* points, std::size_t n, double size);

// Whether each value lies in an odd cell, that is, floor(value / size) is odd.
std::vector<std::uint8_t> odd_cells(const float* values, std::size_t count, double size);

// The mean point of every occupied cell in the order of the keys, (m, 3) row-major.
std::vector<float> voxel_grid(const float* points, std::size_t n, double size);

// Stable sort of (key, value) pairs by key, by radix; `bits` is the width of the largest key.
void radix_sort(std::vector<std::uint64_t>& keys, std::vector<std::uint32_t>& values, int bits);

}  // namespace segloc
