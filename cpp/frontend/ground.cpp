#include "frontend/ground.h"

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <limits>
#include <stdexcept>

namespace segloc {
namespace {

constexpr double kMaxCells = 6.4e7;
constexpr double kMostCells = 1e12;  // from the origin: beyond it a quotient is not a cell any more
constexpr std::int64_t kSupportRadius = 10;  // cells
constexpr double kSupportSlope = 0.05;       // how fast the band of support widens with distance
constexpr int kEnoughSupport = 24;           // cells
constexpr double kSupportShare = 0.15;
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
  for (const double v : {low[0], low[1], high[0], high[1]}) {
    if (!(std::abs(v) / cell < kMostCells))
      throw std::invalid_argument("the cloud is too far from the origin for this ground cell");
  }
  const double nx = std::floor(high[0] / cell) - std::floor(low[0] / cell) + 1;
  const double ny = std::floor(high[1] / cell) - std::floor(low[1] / cell) + 1;
  if (!(nx * ny <= kMaxCells))
    throw std::invalid_argument("the cloud is too wide for a ground grid");
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
    float& z = grid.at(std::clamp<std::int64_t>(ix, 0, grid.nx - 1),
                       std::clamp<std::int64_t>(iy, 0, grid.ny - 1));
    z = std::min(z, points[3 * i + 2]);
  }
  return grid;
}

// Whether enough of the cells around one have their lowest point at about the same height. Rings
// are searched from the inside out, so that ordinary ground is settled after a few cells.
bool is_supported(const Grid& grid, std::int64_t ix, std::int64_t iy, double margin) {
  const float z = grid.get(ix, iy);
  int known = 0, level = 0;
  for (std::int64_t radius = 1; radius <= kSupportRadius; ++radius) {
    const auto band = static_cast<float>(margin + kSupportSlope * grid.cell * double(radius));
    for (std::int64_t y = std::max<std::int64_t>(iy - radius, 0);
         y <= std::min(iy + radius, grid.ny - 1); ++y) {
      // The two rows of a ring are walked in full, the sides only at their ends.
      const std::int64_t step = std::abs(y - iy) == radius ? 1 : 2 * radius;
      for (std::int64_t x = ix - radius; x <= ix + radius; x += step) {
        if (x < 0 || x >= grid.nx || grid.get(x, y) == kUnknown) continue;
        ++known;
        if (std::fabs(grid.get(x, y) - z) <= band) ++level;
      }
    }
    if (level >= kEnoughSupport) return true;
  }
  return level >= kSupportShare * known;
}

// Stray returns below the ground (mirror images in windows and car doors), alone or in clumps,
// would pull the whole envelope down: what the surroundings do not support is forgotten.
void drop_outliers(Grid& grid, double margin) {
  std::vector<float> kept = grid.z;
  for (std::int64_t iy = 0; iy < grid.ny; ++iy) {
    for (std::int64_t ix = 0; ix < grid.nx; ++ix) {
      if (grid.get(ix, iy) == kUnknown || is_supported(grid, ix, iy, margin)) continue;
      kept[static_cast<std::size_t>(iy * grid.nx + ix)] = kUnknown;
    }
  }
  const bool any = std::any_of(kept.begin(), kept.end(), [](float z) { return z != kUnknown; });
  if (any) grid.z = std::move(kept);
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
  drop_outliers(grid, options.outlier);
  lower_envelope(grid, options.max_slope);
  for (std::size_t i = 0; i < n; ++i) {
    heights[i] = points[3 * i + 2] - ground_at(grid, points[3 * i], points[3 * i + 1]);
  }
  return heights;
}

}  // namespace segloc
