#include "verification/correlation.h"

#include <algorithm>
#include <cmath>

namespace segloc {
namespace {

constexpr std::uint8_t kHere = 2, kBeside = 1;  // what an occupied cell counts, and one beside it
constexpr int kLayers = 8;
constexpr double kLayer = 1.0;    // metres
constexpr double kBelow = 3.0;    // of the lowest layer's bottom, under the sensor, metres
constexpr double kBetween = 0.3;  // so near its edge, a map point fills the next layer as well

// -1 for all that is lower, kLayers for all that is higher.
int layer_of(double above) {
  const double layer = std::floor((above + kBelow) / kLayer);
  return static_cast<int>(std::clamp(layer, -1.0, double(kLayers)));
}

// Layers of the map's occupancy around a place, each a plane of bytes.
class Planes {
 public:
  Planes(const PointIndex& map, const double* centre, double reach, double cell)
      : cell_(cell),
        half_(static_cast<int>(std::ceil(reach / cell)) + 1),
        side_(2 * half_ + 1),
        occupied_(static_cast<std::size_t>(kLayers) * side_ * side_, 0) {
    map.visit(centre[0], centre[1], reach * std::sqrt(2.0), [&](const PointGrid::Point& p) {
      fill(p[0] - centre[0], p[1] - centre[1], p[2] - centre[2]);
    });
  }

  // The row of a layer from a cell on; cells are counted from the centre's.
  const std::uint8_t* row(int layer, int y, int x) const {
    return occupied_.data() + index(layer, y + half_, x + half_);
  }
  // How far from the centre a point may lie that is shifted by so much.
  double reach(double shift) const { return (half_ - 1) * cell_ - shift; }
  int cell(double v) const { return static_cast<int>(std::floor(v / cell_ + 0.5)); }

 private:
  std::size_t index(int layer, int y, int x) const {
    return (static_cast<std::size_t>(layer) * side_ + y) * side_ + x;
  }

  void fill(double x, double y, double z) {
    const int cx = cell(x) + half_, cy = cell(y) + half_;
    const int low = std::max(layer_of(z - kBetween), 0);
    const int high = std::min(layer_of(z + kBetween), kLayers - 1);
    if (cx < 0 || cy < 0 || cx >= side_ || cy >= side_) return;
    for (int layer = low; layer <= high; ++layer) {
      for (int by = std::max(cy - 1, 0); by <= std::min(cy + 1, side_ - 1); ++by) {
        for (int bx = std::max(cx - 1, 0); bx <= std::min(cx + 1, side_ - 1); ++bx) {
          std::uint8_t& cell = occupied_[index(layer, by, bx)];
          cell = std::max(cell, by == cy && bx == cx ? kHere : kBeside);
        }
      }
    }
  }

  double cell_;
  int half_, side_;
  std::vector<std::uint8_t> occupied_;
};

struct Cell {
  int layer, y, x;
  bool operator<(const Cell& o) const {
    return layer != o.layer ? layer < o.layer : y != o.y ? y < o.y : x < o.x;
  }
  bool operator==(const Cell& o) const { return layer == o.layer && y == o.y && x == o.x; }
};

// The cells of the query's points at one heading, evenly thinned.
std::vector<Cell> query_cells(const Planes& planes, const float* points, std::size_t m,
                              const double* T, double heading, const CorrelationOptions& options) {
  const double c = std::cos(heading), s = std::sin(heading);
  std::vector<Cell> cells;
  for (std::size_t i = 0; i < m; ++i) {
    const float* p = points + 3 * i;
    if (!(double(p[0]) * p[0] + double(p[1]) * p[1] < options.range * options.range)) continue;
    const double turned[3] = {c * p[0] - s * p[1], s * p[0] + c * p[1], double{p[2]}};
    double moved[3];
    for (int a = 0; a < 3; ++a) {
      moved[a] = T[4 * a] * turned[0] + T[4 * a + 1] * turned[1] + T[4 * a + 2] * turned[2];
    }
    if (!(std::max(std::abs(moved[0]), std::abs(moved[1])) < planes.reach(options.half_width))) {
      continue;  // it would leave the planes: the transform is far from level
    }
    const int layer = layer_of(moved[2]);
    if (layer < 0 || layer >= kLayers) continue;
    cells.push_back({layer, planes.cell(moved[1]), planes.cell(moved[0])});
  }
  std::sort(cells.begin(), cells.end());
  cells.erase(std::unique(cells.begin(), cells.end()), cells.end());
  if (cells.size() > options.cells) {
    std::vector<Cell> some;
    for (std::size_t k = 0; k < options.cells; ++k) {
      some.push_back(cells[k * cells.size() / options.cells]);
    }
    cells.swap(some);
  }
  return cells;
}

}  // namespace

Correlation correlate(const PointIndex& map, const float* points, std::size_t m, const double* T,
                      const std::vector<double>& headings, const CorrelationOptions& options) {
  const double centre[3] = {T[3], T[7], T[11]};
  const int half = static_cast<int>(std::lround(options.half_width / options.cell));
  const double reach = options.range + (half + 2) * options.cell;
  const Planes planes(map, centre, reach, options.cell);
  Correlation result;
  result.width = 2 * static_cast<std::size_t>(half) + 1;
  result.counts.assign(headings.size() * result.width * result.width, 0);
  for (std::size_t h = 0; h < headings.size(); ++h) {
    const auto cells = query_cells(planes, points, m, T, headings[h], options);
    result.used.push_back(static_cast<std::uint16_t>(cells.size()));
    std::uint16_t* counts = result.counts.data() + h * result.width * result.width;
    for (const Cell& cell : cells) {
      for (int dy = -half; dy <= half; ++dy) {
        const std::uint8_t* map_row = planes.row(cell.layer, cell.y + dy, cell.x - half);
        std::uint16_t* sums = counts + static_cast<std::size_t>(dy + half) * result.width;
        for (std::size_t k = 0; k < result.width; ++k) {
          sums[k] = static_cast<std::uint16_t>(sums[k] + map_row[k]);
        }
      }
    }
  }
  return result;
}

}  // namespace segloc
