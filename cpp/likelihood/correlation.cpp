#include "likelihood/correlation.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstring>

#include "common/cells.h"
#include "common/portability.h"

namespace segloc {
namespace {

// Scores of an occupied cell, of one beside it, and of one in unmapped space.
constexpr std::uint8_t kHere = 4, kBeside = 2, kUnmapped = 1;
constexpr int kBlock = 4;           // cells along the edge of a block that is mapped or not
constexpr std::size_t kRun = 64;    // shifts that are counted at once
constexpr std::size_t kGroup = 63;  // cells whose counts add up to a byte
constexpr int kLayers = 8;
constexpr double kLayer = 1.0;    // metres
constexpr double kBelow = 3.0;    // of the lowest layer's bottom, under the sensor, metres
constexpr double kBetween = 0.3;  // metres from its edge: a point fills the next layer, too

// -1 for all that is lower, kLayers for all that is higher.
int layer_of(double above) {
  const double layer = std::clamp((above + kBelow) / kLayer, -1.0, double(kLayers));
  return static_cast<int>(floor_of(layer));
}

// Layers of the map's occupancy around a place, each a plane of bytes.
class Planes {
 public:
  // Cells up to `reach` metres along x and y; the map's points up to `range`.
  Planes(const PointIndex& map, const double* centre, double reach, double range, double cell)
      : cells_per_metre_(1.0 / cell),
        half_(static_cast<int>(std::ceil(reach / cell)) + 1),
        side_(2 * half_ + 1),
        values_(static_cast<std::size_t>(kLayers) * side_ * side_ + kRun, 0) {
    for (int y = 0; y < side_; y += kBlock) {
      for (int x = 0; x < side_; x += kBlock) {
        const double at[2] = {centre[0] + (x - half_) * cell, centre[1] + (y - half_) * cell};
        if (!map.is_mapped(static_cast<float>(at[0]), static_cast<float>(at[1]))) leave(x, y);
      }
    }
    // The occupied layers of each cell, a bit each; with cells beside the first and the last.
    const std::size_t wide = static_cast<std::size_t>(side_) + 2;
    std::vector<std::uint8_t> occupied(wide * wide, 0);
    map.visit_about(centre[0], centre[1], range, [&](const float* const* xyz, std::size_t count) {
      mark(xyz, count, centre, occupied.data());
    });
    for (int y = 0; y < side_; ++y) value(&occupied[(y + 1) * wide], y);
  }

  // The row of a layer from a cell on; cells are counted from the centre's. A run may be read past
  // its end.
  const std::uint8_t* row(int layer, int y, int x) const {
    return values_.data() + index(layer, y + half_, x + half_);
  }
  std::ptrdiff_t shift(int y, int x) const { return std::ptrdiff_t{y} * side_ + x; }
  // Largest distance of a point from the centre, after its shift.
  double reach(double shift) const { return (half_ - 1) / cells_per_metre_ - shift; }
  int cell_of(double v) const { return static_cast<int>(floor_of(v * cells_per_metre_ + 0.5)); }

 private:
  std::size_t index(int layer, int y, int x) const {
    return (static_cast<std::size_t>(layer) * side_ + y) * side_ + x;
  }

  // Marks the layers of points. The compiler turns the first loop into vectors.
  void mark(const float* const* xyz, std::size_t count, const double* centre,
            std::uint8_t* occupied) const {
    // Cells from the margin's first one on, and layers from the one below the lowest.
    std::array<std::int32_t, PointIndex::kBlock> x, y, low, high;
    const auto whole = [](double v, double most) {
      const double least = v > 0.0 ? v : 0.0;
      return static_cast<std::int32_t>(least < most ? least : most);
    };
    const double wide = side_ + 2, from = half_ + 1.5, bottom = kBelow + kLayer;
    for (std::size_t i = 0; i < count; ++i) {
      const double z = xyz[2][i] - centre[2] + bottom;
      x[i] = whole((xyz[0][i] - centre[0]) * cells_per_metre_ + from, wide - 1.0);
      y[i] = whole((xyz[1][i] - centre[1]) * cells_per_metre_ + from, wide - 1.0);
      low[i] = whole((z - kBetween) / kLayer, kLayers + 1.0);
      high[i] = whole((z + kBetween) / kLayer, kLayers + 1.0);
    }
    for (std::size_t i = 0; i < count; ++i) {
      const unsigned layers = 1u << low[i] | 1u << high[i];
      occupied[y[i] * (side_ + 2) + x[i]] |= static_cast<std::uint8_t>(layers >> 1);
    }
  }

  // A block in which the map has nothing.
  void leave(int x, int y) {
    const int run = std::min(kBlock, side_ - x);
    for (int layer = 0; layer < kLayers; ++layer) {
      for (int by = y; by < std::min(y + kBlock, side_); ++by) {
        std::fill_n(&values_[index(layer, by, x)], run, kUnmapped);
      }
    }
  }

  // A row of all layers, by what is occupied in and beside it.
  void value(const std::uint8_t* row, int y) {
    const int wide = side_ + 2;
    std::vector<std::uint8_t> column(static_cast<std::size_t>(wide)), beside(column);
    for (int x = 0; x < wide; ++x) column[x] = row[x - wide] | row[x] | row[x + wide];
    for (int x = 0; x < side_; ++x) beside[x] = column[x] | column[x + 1] | column[x + 2];
    for (int layer = 0; layer < kLayers; ++layer) {
      std::uint8_t* values = &values_[index(layer, y, 0)];
      for (int x = 0; x < side_; ++x) {
        const int here = kHere * (row[x + 1] >> layer & 1);
        const int near = kBeside * (beside[x] >> layer & 1);
        values[x] = static_cast<std::uint8_t>(std::max<int>(values[x], std::max(here, near)));
      }
    }
  }

  double cells_per_metre_;
  int half_, side_;
  std::vector<std::uint8_t> values_;
};

struct Cell {
  int layer, y, x;
};

// Cells as numbers that sort by layer, y and x.
constexpr int kBits = 16;
std::uint64_t key_of(int layer, int y, int x) {
  const int far = 1 << (kBits - 1);
  return (static_cast<std::uint64_t>(layer) << (2 * kBits)) |
         (static_cast<std::uint64_t>(y + far) << kBits) | static_cast<std::uint64_t>(x + far);
}
Cell cell_of(std::uint64_t key) {
  const int far = 1 << (kBits - 1), mask = (1 << kBits) - 1;
  return {static_cast<int>(key >> (2 * kBits)), static_cast<int>((key >> kBits) & mask) - far,
          static_cast<int>(key & mask) - far};
}

// The cells of the query's points at one heading, evenly thinned.
std::vector<Cell> query_cells(const Planes& planes, const float* points, std::size_t m,
                              const double* T, double heading, const CorrelationOptions& options) {
  const double c = std::cos(heading), s = std::sin(heading);
  std::vector<std::uint64_t> keys;
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
    keys.push_back(key_of(layer, planes.cell_of(moved[1]), planes.cell_of(moved[0])));
  }
  std::sort(keys.begin(), keys.end());
  keys.erase(std::unique(keys.begin(), keys.end()), keys.end());
  const std::size_t count = std::min(keys.size(), options.cells);
  std::vector<Cell> cells;
  for (std::size_t k = 0; k < count; ++k) cells.push_back(cell_of(keys[k * keys.size() / count]));
  return cells;
}

SEGLOC_VECTOR(std::uint8_t, Bytes, 16);
constexpr std::size_t kVectors = kRun / sizeof(Bytes);

// Adds a run of each row to the sums. A byte each: no more than kGroup rows.
void add_run(const std::uint8_t* const* rows, std::size_t count, std::uint16_t* sums) {
  Bytes sum[kVectors] = {};
  for (std::size_t i = 0; i < count; ++i) {
    SEGLOC_UNROLL
    for (std::size_t k = 0; k < kVectors; ++k) {
      Bytes part;
      std::memcpy(&part, rows[i] + k * sizeof(Bytes), sizeof(Bytes));
      sum[k] += part;
    }
  }
  std::uint8_t total[kRun];
  std::memcpy(total, sum, kRun);
  for (std::size_t k = 0; k < kRun; ++k) sums[k] = static_cast<std::uint16_t>(sums[k] + total[k]);
}

// The counts of all shifts by up to `half` cells, (width, width).
std::vector<std::uint16_t> counted(const Planes& planes, const std::vector<Cell>& cells, int half) {
  const auto width = 2 * static_cast<std::size_t>(half) + 1;
  const std::size_t padded = (width + kRun - 1) / kRun * kRun;
  std::vector<std::uint16_t> counts, sums(padded);
  counts.reserve(width * width);
  std::vector<const std::uint8_t*> first, rows(cells.size());
  for (const Cell& cell : cells) first.push_back(planes.row(cell.layer, cell.y, cell.x));
  for (int dy = -half; dy <= half; ++dy) {
    std::fill(sums.begin(), sums.end(), std::uint16_t{0});
    for (std::size_t run = 0; run < padded; run += kRun) {
      const int x = static_cast<int>(run) - half;
      for (std::size_t i = 0; i < cells.size(); ++i) rows[i] = first[i] + planes.shift(dy, x);
      for (std::size_t i = 0; i < cells.size(); i += kGroup) {
        add_run(&rows[i], std::min(kGroup, cells.size() - i), &sums[run]);
      }
    }
    counts.insert(counts.end(), sums.begin(), sums.begin() + static_cast<std::ptrdiff_t>(width));
  }
  return counts;
}

}  // namespace

Correlation correlate(const PointIndex& map, const float* points, std::size_t m, const double* T,
                      const std::vector<double>& headings, const CorrelationOptions& options) {
  const double centre[3] = {T[3], T[7], T[11]};
  const int half = static_cast<int>(std::lround(options.half_width / options.cell));
  const double shift = (half + 2) * options.cell;
  const Planes planes(map, centre, options.range + shift,
                      options.range + (shift + options.cell) * std::sqrt(2.0), options.cell);
  Correlation result;
  result.width = 2 * static_cast<std::size_t>(half) + 1;
  for (const double heading : headings) {
    const auto cells = query_cells(planes, points, m, T, heading, options);
    const auto counts = counted(planes, cells, half);
    result.used.push_back(static_cast<std::uint16_t>(cells.size()));
    result.counts.insert(result.counts.end(), counts.begin(), counts.end());
  }
  return result;
}

}  // namespace segloc
