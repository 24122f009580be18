#include "proposals/occupancy/polar_images.h"

#include <algorithm>
#include <cmath>

#include "common/angles.h"
#include "common/parallel.h"

namespace segloc {
namespace {

constexpr double kStrips = 4;       // as wide, together, as the radius of an image
constexpr std::size_t kGrain = 16;  // places

struct Cell {
  double strip;  // of the y axis
  float x, y;
  std::uint8_t slices;
};

// The sector of a direction, by the edges of all: an arc tangent for each cell would take longer.
class Sectors {
 public:
  explicit Sectors(int count) : half_(count / 2) {
    for (int k = 0; k <= half_; ++k) {
      edges_.push_back({std::cos(kPi * k / half_), std::sin(kPi * k / half_)});
    }
    int sector = 0;
    for (int k = 0; k <= kParts; ++k) {  // from one part before: quotients are rounded
      while (sector + 1 < half_ && part_of(edges_[sector + 1]) * kParts <= k - 1) ++sector;
      first_[k] = sector;
    }
  }

  int of(double x, double y) const {
    const bool turned = y < 0 || (y == 0 && x < 0);
    const Direction d = turned ? Direction{-x, -y} : Direction{x, y};
    int sector = first_[static_cast<int>(part_of(d) * kParts)];
    while (sector + 1 < half_ && edges_[sector + 1].x * d.y >= edges_[sector + 1].y * d.x) {
      ++sector;
    }
    return turned ? sector + half_ : sector;
  }

 private:
  static constexpr int kParts = 512;
  struct Direction {
    double x, y;
  };
  // Rises with the angle of an upper half turn, from 0 to 1.
  static double part_of(Direction d) {
    const double length = std::abs(d.x) + d.y;
    return length > 0 ? 0.5 - 0.5 * d.x / length : 0.0;
  }

  int half_;
  std::vector<Direction> edges_;
  int first_[kParts + 1];
};

}  // namespace

std::vector<std::uint8_t> polar_images(const float* cells, const std::uint8_t* slices,
                                       std::size_t n, const float* places, std::size_t p,
                                       const PolarGrid& grid, int threads) {
  const double radius = grid.ring_m * grid.rings, strip = radius / kStrips;
  std::vector<Cell> sorted(n);
  for (std::size_t i = 0; i < n; ++i) {
    sorted[i] = {std::floor(cells[2 * i + 1] / strip), cells[2 * i], cells[2 * i + 1], slices[i]};
  }
  std::sort(sorted.begin(), sorted.end(), [](const Cell& a, const Cell& b) {
    return a.strip < b.strip || (a.strip == b.strip && a.x < b.x);
  });
  const Sectors sectors(grid.sectors);
  const auto bands = static_cast<std::size_t>(grid.bands);
  const auto around = static_cast<std::size_t>(grid.sectors);
  const std::size_t size = static_cast<std::size_t>(grid.rings) * bands * around;
  const int in_band = 8 / grid.bands, band = (1 << in_band) - 1;
  std::vector<std::uint8_t> images(p * size);

  const auto fill = [&](const float* place, std::uint8_t* image) {
    const double x = place[0], y = place[1];
    const double last = std::floor((y + radius) / strip);
    for (double k = std::floor((y - radius) / strip); k <= last; ++k) {
      const auto from = std::lower_bound(
          sorted.begin(), sorted.end(), x - radius, [k](const Cell& cell, double left) {
            return cell.strip < k || (cell.strip == k && cell.x < left);
          });
      for (auto cell = from; cell != sorted.end(); ++cell) {
        if (cell->strip > k || cell->x > x + radius) break;
        const double dx = cell->x - x, dy = cell->y - y;
        const double ring = std::sqrt(dx * dx + dy * dy) / grid.ring_m;
        if (!(ring < grid.rings)) continue;
        std::uint8_t* at = image + static_cast<std::size_t>(ring) * bands * around +
                           static_cast<std::size_t>(sectors.of(dx, dy));
        for (std::size_t b = 0; b < bands; ++b) {
          at[b * around] |= (cell->slices >> (static_cast<int>(b) * in_band) & band) != 0;
        }
      }
    }
  };
  parallel_for(p, kGrain, threads, [&](std::size_t begin, std::size_t end, int) {
    for (std::size_t k = begin; k < end; ++k) fill(places + 2 * k, images.data() + k * size);
  });
  return images;
}

}  // namespace segloc
