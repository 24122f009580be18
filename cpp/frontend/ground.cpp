#include "frontend/ground.h"

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <limits>
#include <stdexcept>

#include "common/cells.h"
#include "simd/kernels.h"

namespace segloc {
namespace {

constexpr double kMaxCells = 6.4e7;
constexpr double kMostCells = 1e12;  // from the origin: beyond it a quotient is not a cell any more
constexpr std::int64_t kSupportRadius = 10;  // cells
constexpr double kSupportSlope = 0.05;       // how fast the band of support widens with distance
constexpr int kEnoughSupport = 24;           // cells
constexpr double kSupportShare = 0.15;
constexpr std::size_t kChunk = 1024;  // points whose cells are computed at a time, from cache
constexpr std::size_t kBehind = 15;   // values behind a row that vectors reach
constexpr float kUnknown = std::numeric_limits<float>::infinity();

bool is_power_of_two(double edge) {
  int exponent = 0;
  return std::frexp(edge, &exponent) == 0.5 && std::isfinite(1.0 / edge);
}

// The lowest point of each cell, with a border of unknown ones: no neighbour is out of bounds.
struct Grid {
  static constexpr std::int64_t kBorder = kSupportRadius;

  Grid(double edge, double low_x, double low_y, std::int64_t columns, std::int64_t rows)
      : x0(low_x), y0(low_y), cell(edge), nx(columns), ny(rows), stride(columns + 2 * kBorder),
        z(static_cast<std::size_t>(stride * (rows + 2 * kBorder)), kUnknown) {}

  GroundLattice lattice() const {
    const auto narrow = [](std::int64_t v) { return static_cast<std::int32_t>(v); };
    return {x0, y0, cell, is_power_of_two(cell), narrow(nx), narrow(ny), narrow(stride)};
  }

  float* row(std::int64_t iy) { return z.data() + (iy + kBorder) * stride + kBorder; }
  const float* row(std::int64_t iy) const { return z.data() + (iy + kBorder) * stride + kBorder; }

  double x0, y0, cell;
  std::int64_t nx, ny, stride;
  std::vector<float> z;
};

Grid lowest_points(const float* points, std::size_t n, double cell) {
  const Extent extent = extent_of(points, n);
  for (const double v : {extent.low[0], extent.low[1], extent.high[0], extent.high[1]}) {
    if (!(std::abs(v) / cell < kMostCells))
      throw std::invalid_argument("the cloud is too far from the origin for this ground cell");
  }
  double first[2], count[2];
  for (int a = 0; a < 2; ++a) {
    first[a] = std::floor(extent.low[a] / cell);
    count[a] = std::floor(extent.high[a] / cell) - first[a] + 1;
  }
  if (!(count[0] * count[1] <= kMaxCells))
    throw std::invalid_argument("the cloud is too wide for a ground grid");
  Grid grid(cell, first[0] * cell, first[1] * cell, static_cast<std::int64_t>(count[0]),
            static_cast<std::int64_t>(count[1]));
  const GroundLattice lattice = grid.lattice();
  float* z = grid.row(0);
  std::int32_t cells[kChunk];
  for (std::size_t begin = 0; begin < n; begin += kChunk) {
    const std::size_t size = std::min(kChunk, n - begin);
    const float* p = points + 3 * begin;
    best_kernels().ground_cells(p, size, lattice, cells);
    for (std::size_t i = 0; i < size; ++i) {
      if (p[3 * i + 2] < z[cells[i]]) z[cells[i]] = p[3 * i + 2];
    }
  }
  return grid;
}

// Whether enough of the cells around one have their lowest point at about the same height. Heights
// may differ the more the farther cells are apart.
class Support {
 public:
  Support(const Grid& grid, double margin) : grid_(grid) {
    for (std::int64_t dy = -kSupportRadius; dy <= kSupportRadius; ++dy) {
      for (std::int64_t dx = -kSupportRadius; dx <= kSupportRadius; ++dx) {
        const std::int64_t ring = std::max(std::abs(dx), std::abs(dy));
        const double band = margin + kSupportSlope * grid.cell * double(ring);
        band_[dy + kSupportRadius][dx + kSupportRadius] = static_cast<float>(band);
      }
    }
  }

  // How many of the nearest cells around each cell of a row support it: most need no more.
  void count_nearest(std::int64_t iy, std::int32_t* level) const {
    constexpr int kNearest = 3;
    best_kernels().count_like(grid_.row(iy), grid_.stride, static_cast<std::size_t>(grid_.nx),
                              &band_[kSupportRadius][kSupportRadius], 2 * kSupportRadius + 1,
                              kNearest, level);
  }

  // Whether a cell that has a point is supported, by all around it.
  bool holds(std::int64_t ix, std::int64_t iy) const {
    const float z = grid_.row(iy)[ix];
    std::int32_t level = -1, known = -1;  // without itself
    for (std::int64_t dy = -kSupportRadius; dy <= kSupportRadius; ++dy) {
      const float* other = grid_.row(iy + dy) + ix - kSupportRadius;
      const float* band = band_[dy + kSupportRadius];
      for (std::int64_t x = 0; x <= 2 * kSupportRadius; ++x) {
        level += std::fabs(other[x] - z) <= band[x];
        known += other[x] != kUnknown;
      }
    }
    return level >= kEnoughSupport || level >= kSupportShare * known;
  }

 private:
  const Grid& grid_;
  float band_[2 * kSupportRadius + 1][2 * kSupportRadius + 1];
};

// Stray returns below the ground (reflections in windows and car doors) would lower the envelope:
// cells without support around them are ignored.
void drop_outliers(Grid& grid, double margin) {
  const Support support(grid, margin);
  std::vector<std::int32_t> level(static_cast<std::size_t>(grid.nx) + kBehind);
  std::vector<std::size_t> dropped;
  bool any = false;  // is supported
  for (std::int64_t iy = 0; iy < grid.ny; ++iy) {
    support.count_nearest(iy, level.data());
    const float* z = grid.row(iy);
    for (std::int64_t ix = 0; ix < grid.nx; ++ix) {
      if (z[ix] == kUnknown) continue;
      const bool holds =
          level[static_cast<std::size_t>(ix)] >= kEnoughSupport || support.holds(ix, iy);
      any |= holds;
      if (!holds) dropped.push_back(static_cast<std::size_t>(z + ix - grid.z.data()));
    }
  }
  if (!any) return;
  for (const std::size_t at : dropped) grid.z[at] = kUnknown;
}

// Two chamfer sweeps give the lower envelope of cones of slope max_slope.
void lower_envelope(Grid& grid, double max_slope) {
  const auto side = static_cast<float>(max_slope * grid.cell);
  const auto diagonal = static_cast<float>(max_slope * grid.cell * std::sqrt(2.0));
  const auto relax_row = [&](float* z, const float* other) {
    for (std::int64_t x = 0; x < grid.nx; ++x) {
      const float across = std::min(other[x - 1], other[x + 1]) + diagonal;
      z[x] = std::min(z[x], std::min(across, other[x] + side));
    }
  };
  for (std::int64_t iy = 0; iy < grid.ny; ++iy) {
    float* z = grid.row(iy);
    relax_row(z, grid.row(iy - 1));
    for (std::int64_t x = 0; x < grid.nx; ++x) z[x] = std::min(z[x], z[x - 1] + side);
  }
  for (std::int64_t iy = grid.ny - 1; iy >= 0; --iy) {
    float* z = grid.row(iy);
    relax_row(z, grid.row(iy + 1));
    for (std::int64_t x = grid.nx - 1; x >= 0; --x) z[x] = std::min(z[x], z[x + 1] + side);
  }
}

}  // namespace

std::vector<float> heights_above_ground(const float* points, std::size_t n,
                                        const GroundOptions& options) {
  if (!(options.cell > 0.0)) throw std::invalid_argument("ground cell must be positive");
  std::vector<float> heights(n);
  if (n == 0) return heights;
  Grid grid = lowest_points(points, n, options.cell);
  drop_outliers(grid, options.outlier);
  lower_envelope(grid, options.max_slope);
  best_kernels().ground_heights(points, n, grid.lattice(), grid.row(0), heights.data());
  return heights;
}

void split_by_height(const float* points, const float* heights, std::size_t n, double cut,
                     std::vector<float>& above, std::vector<float>& below) {
  const auto high = [&](std::size_t i) { return heights[i] > cut; };
  std::size_t count = 0;
  for (std::size_t i = 0; i < n; ++i) count += high(i);
  above.resize(3 * count + 3), below.resize(3 * (n - count) + 3);  // one more: no branch to guess
  float *to = above.data(), *other = below.data();
  for (std::size_t i = 0; i < n; ++i) {
    for (std::size_t a = 0; a < 3; ++a) to[a] = other[a] = points[3 * i + a];
    to += high(i) ? 3 : 0;
    other += high(i) ? 0 : 3;
  }
  above.resize(3 * count), below.resize(3 * (n - count));
}

}  // namespace segloc
