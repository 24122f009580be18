#include "ground.h"

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <limits>
#include <stdexcept>

namespace segloc {
namespace {

constexpr double kMaxCells = 6.4e7;
constexpr float kUnknown = std::numeric_limits<float>::infinity();

struct Grid {
  double x0 = 0.0, y0 = 0.0, cell = 1.0;
  std::int64_t nx = 0, ny = 0;
  std::vector<float> z;

  float& at(std::int64_t ix, std::int64_t iy) { return z[static_cast<std::size_t>(iy * nx + ix)]; }
  float get(std::int64_t ix, std::int64_t iy) const {
    return z[static_cast<std::size_t>(iy * nx + ix)];
  }
};

Grid lowest_points(const float* points, std::size_t n, double cell) {
  double low[2] = {points[0], points[1]}, high[2] = {points[0], points[1]};
  for (std::size_t i = 0; i < n; ++i) {
    for (int a = 0; a < 2; ++a) {
      low[a] = std::min<double>(low[a], points[3 * i + a]);
      high[a] = std::max<double>(high[a], points[3 * i + a]);
    }
  }
  const double nx = std::floor(high[0] / cell) - std::floor(low[0] / cell) + 1;
  const double ny = std::floor(high[1] / cell) - std::floor(low[1] / cell) + 1;
  if (!(nx * ny <= kMaxCells)) throw std::invalid_argument("the cloud is too wide for a ground grid");
  Grid grid;
  grid.cell = cell;
  grid.x0 = std::floor(low[0] / cell) * cell;
  grid.y0 = std::floor(low[1] / cell) * cell;
  grid.nx = static_cast<std::int64_t>(nx);
  grid.ny = static_cast<std::int64_t>(ny);
  grid.z.assign(static_cast<std::size_t>(grid.nx * grid.ny), kUnknown);
  for (std::size_t i = 0; i < n; ++i) {
    const auto ix = static_cast<std::int64_t>((points[3 * i] - grid.x0) / cell);
    const auto iy = static_cast<std::int64_t>((points[3 * i + 1] - grid.y0) / cell);
    float& z = grid.at(std::min(ix, grid.nx - 1), std::min(iy, grid.ny - 1));
    z = std::min(z, points[3 * i + 2]);
  }
  return grid;
}

// Stray returns below the ground (reflections) would pull the whole envelope down: a cell far below
// the median of its neighbourhood is forgotten.
void drop_outliers(Grid& grid, double margin, double max_slope) {
  const std::vector<float> lowest = grid.z;
  const auto limit = static_cast<float>(margin + 2.0 * max_slope * grid.cell);
  std::vector<float> near;
  for (std::int64_t iy = 0; iy < grid.ny; ++iy) {
    for (std::int64_t ix = 0; ix < grid.nx; ++ix) {
      near.clear();
      for (std::int64_t y = std::max<std::int64_t>(iy - 2, 0); y <= std::min(iy + 2, grid.ny - 1); ++y) {
        for (std::int64_t x = std::max<std::int64_t>(ix - 2, 0); x <= std::min(ix + 2, grid.nx - 1); ++x) {
          const float z = lowest[static_cast<std::size_t>(y * grid.nx + x)];
          if (z != kUnknown && (x != ix || y != iy)) near.push_back(z);
        }
      }
      if (near.size() < 4 || grid.get(ix, iy) == kUnknown) continue;
      // The lower quartile rather than the median: around a building most cells hold walls only.
      const auto quartile = near.begin() + static_cast<std::ptrdiff_t>(near.size() / 4);
      std::nth_element(near.begin(), quartile, near.end());
      if (grid.get(ix, iy) < *quartile - limit) grid.at(ix, iy) = kUnknown;
    }
  }
}

// Two chamfer sweeps give the lower envelope of cones of slope max_slope.
void lower_envelope(Grid& grid, double max_slope) {
  const auto side = static_cast<float>(max_slope * grid.cell);
  const auto diagonal = static_cast<float>(max_slope * grid.cell * std::sqrt(2.0));
  const auto relax = [&](std::int64_t ix, std::int64_t iy, int dx, int dy) {
    const std::int64_t x = ix + dx, y = iy + dy;
    if (x < 0 || y < 0 || x >= grid.nx || y >= grid.ny) return;
    float& z = grid.at(ix, iy);
    z = std::min(z, grid.get(x, y) + (dx != 0 && dy != 0 ? diagonal : side));
  };
  for (std::int64_t iy = 0; iy < grid.ny; ++iy) {
    for (std::int64_t ix = 0; ix < grid.nx; ++ix) {
      relax(ix, iy, -1, 0);
      for (int dx = -1; dx <= 1; ++dx) relax(ix, iy, dx, -1);
    }
  }
  for (std::int64_t iy = grid.ny - 1; iy >= 0; --iy) {
    for (std::int64_t ix = grid.nx - 1; ix >= 0; --ix) {
      relax(ix, iy, 1, 0);
      for (int dx = -1; dx <= 1; ++dx) relax(ix, iy, dx, 1);
    }
  }
}

// Bilinear between cell centres.
float ground_at(const Grid& grid, float px, float py) {
  const double x = std::clamp((px - grid.x0) / grid.cell - 0.5, 0.0, double(grid.nx - 1));
  const double y = std::clamp((py - grid.y0) / grid.cell - 0.5, 0.0, double(grid.ny - 1));
  const auto ix = static_cast<std::int64_t>(x), iy = static_cast<std::int64_t>(y);
  const std::int64_t jx = std::min(ix + 1, grid.nx - 1), jy = std::min(iy + 1, grid.ny - 1);
  const double u = x - double(ix), v = y - double(iy);
  const double near = (1 - u) * grid.get(ix, iy) + u * grid.get(jx, iy);
  const double far = (1 - u) * grid.get(ix, jy) + u * grid.get(jx, jy);
  return static_cast<float>((1 - v) * near + v * far);
}

}  // namespace

std::vector<float> heights_above_ground(const float* points, std::size_t n,
                                        const GroundOptions& options) {
  if (!(options.cell > 0.0)) throw std::invalid_argument("ground cell must be positive");
  std::vector<float> heights(n);
  if (n == 0) return heights;
  Grid grid = lowest_points(points, n, options.cell);
  drop_outliers(grid, options.outlier, options.max_slope);
  lower_envelope(grid, options.max_slope);
  for (std::size_t i = 0; i < n; ++i) {
    heights[i] = points[3 * i + 2] - ground_at(grid, points[3 * i], points[3 * i + 1]);
  }
  return heights;
}

}  // namespace segloc
