// Cells and heights of points over a ground grid, and the support of a cell.
#pragma once

#include "simd/kernels.h"
#include "simd/simd.h"

namespace segloc {
namespace SEGLOC_ISA {
namespace {

// Loops over points become vector instructions: no branches, and cells are 32 bits. Where the edge
// of a cell is a power of two a product is as exact as a division, and faster.
template <typename InCells>
inline void cells_of_points(const float* points, size_t count, const GroundLattice& lattice,
                            InCells in_cells, int32_t* cells) {
  const double x0 = lattice.x0, y0 = lattice.y0;
  const int32_t nx = lattice.nx, ny = lattice.ny, stride = lattice.stride;
  for (size_t i = 0; i < count; ++i) {
    auto ix = static_cast<int32_t>(in_cells(static_cast<double>(points[3 * i]) - x0));
    auto iy = static_cast<int32_t>(in_cells(static_cast<double>(points[3 * i + 1]) - y0));
    ix = ix < 0 ? 0 : ix > nx - 1 ? nx - 1 : ix;
    iy = iy < 0 ? 0 : iy > ny - 1 ? ny - 1 : iy;
    cells[i] = iy * stride + ix;
  }
}

void ground_cells(const float* points, size_t count, const GroundLattice& lattice, int32_t* cells) {
  const double edge = lattice.edge, inverse = 1.0 / edge;
  if (lattice.is_power) {
    cells_of_points(points, count, lattice, [=](double v) { return v * inverse; }, cells);
  } else {
    cells_of_points(points, count, lattice, [=](double v) { return v / edge; }, cells);
  }
}

// Where points lie between the centres of cells: the cell below them on both axes, the steps to the
// next ones, and how far they are on the way.
struct Between {
  static constexpr size_t kPoints = 256;

  int32_t cell[kPoints], right[kPoints], up[kPoints];
  double u[kPoints], v[kPoints];
};

template <typename InCells>
inline void place_between(const float* points, size_t count, const GroundLattice& lattice,
                          InCells in_cells, Between& between) {
  const double x0 = lattice.x0, y0 = lattice.y0;
  const int32_t last_x = lattice.nx - 1, last_y = lattice.ny - 1, stride = lattice.stride;
  const double right = last_x, top = last_y;
  for (size_t i = 0; i < count; ++i) {
    double x = in_cells(static_cast<double>(points[3 * i]) - x0) - 0.5;
    double y = in_cells(static_cast<double>(points[3 * i + 1]) - y0) - 0.5;
    x = x < 0.0 ? 0.0 : right < x ? right : x;
    y = y < 0.0 ? 0.0 : top < y ? top : y;
    const auto ix = static_cast<int32_t>(x), iy = static_cast<int32_t>(y);
    between.cell[i] = iy * stride + ix;
    between.right[i] = ix < last_x ? 1 : 0;
    between.up[i] = iy < last_y ? stride : 0;
    between.u[i] = x - static_cast<double>(ix);
    between.v[i] = y - static_cast<double>(iy);
  }
}

void ground_heights(const float* points, size_t count, const GroundLattice& lattice, const float* z,
                    float* heights) {
  const double edge = lattice.edge, inverse = 1.0 / edge;
  Between between;
  float corners[4][Between::kPoints];
  for (size_t begin = 0; begin < count; begin += Between::kPoints) {
    const size_t size = count - begin < Between::kPoints ? count - begin : Between::kPoints;
    const float* p = points + 3 * begin;
    if (lattice.is_power) {
      place_between(p, size, lattice, [=](double v) { return v * inverse; }, between);
    } else {
      place_between(p, size, lattice, [=](double v) { return v / edge; }, between);
    }
    for (size_t i = 0; i < size; ++i) {
      const float *below = z + between.cell[i], *above = below + between.up[i];
      corners[0][i] = below[0], corners[1][i] = below[between.right[i]];
      corners[2][i] = above[0], corners[3][i] = above[between.right[i]];
    }
    for (size_t i = 0; i < size; ++i) {  // bilinear
      const double u = between.u[i], v = between.v[i];
      const double near =
          (1.0 - u) * static_cast<double>(corners[0][i]) + u * static_cast<double>(corners[1][i]);
      const double far =
          (1.0 - u) * static_cast<double>(corners[2][i]) + u * static_cast<double>(corners[3][i]);
      const auto ground = static_cast<float>((1.0 - v) * near + v * far);
      heights[begin + i] = p[3 * i + 2] - ground;
    }
  }
}

void count_like(const float* z, ptrdiff_t stride, size_t count, const float* bands,
                size_t band_stride, int reach, int32_t* level) {
  for (size_t x = 0; x < count; x += kWidth) {
    const Vec own = load(z + x), zero = broadcast(0.0f);
    Vec like = zero;
    for (int dy = -reach; dy <= reach; ++dy) {
      const float* other = z + static_cast<ptrdiff_t>(x) + dy * stride;
      const float* band = bands + static_cast<ptrdiff_t>(band_stride) * dy;
      for (int dx = -reach; dx <= reach; ++dx) {
        if (dx == 0 && dy == 0) continue;
        const Vec off = load(other + dx) - own;
        like = count_not_above(like, max(off, zero - off), broadcast(band[dx]));
      }
    }
    store_whole(level + x, like);
  }
}

}  // namespace
}  // namespace SEGLOC_ISA
}  // namespace segloc
