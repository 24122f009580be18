#include "frontend/point_grid.h"

#include <algorithm>
#include <stdexcept>

#include "common/portability.h"
#include "simd/kernels.h"

namespace segloc {
namespace {

constexpr double kMargin = 1.0 + 1e-4;  // of squared distances in single precision
constexpr std::size_t kLanes = 4;

SEGLOC_VECTOR(float, Floats, 16);
SEGLOC_VECTOR(std::int32_t, Flags, 16);

Floats loaded(const float* from) {
  Floats v;
  copy_bytes(&v, from, sizeof(v));
  return v;
}

Floats all(float value) { return Floats{value, value, value, value}; }

bool any(const Flags& flags) {
  std::uint64_t halves[2];
  copy_bytes(halves, &flags, sizeof(halves));
  return (halves[0] | halves[1]) != 0;
}

// A position, and the squared distances of points from it.
struct Place {
  explicit Place(const PointGrid::Point& p) : x(all(p[0])), y(all(p[1])), z(all(p[2])) {}
  Floats squared(const float* px, const float* py, const float* pz) const {
    const Floats dx = loaded(px) - x, dy = loaded(py) - y, dz = loaded(pz) - z;
    return dx * dx + dy * dy + dz * dz;
  }
  Floats x, y, z;
};

}  // namespace

// Cells twice as wide as the radius: a neighbourhood touches eight of them at most.
PointGrid::PointGrid(const float* points, std::size_t n, double radius, std::int64_t tile_cells,
                     std::vector<std::uint32_t>* rows)
    : cell_(2.0 * radius), per_metre_(1.0 / cell_) {
  CellRuns sorted = sort_into_runs(points, n, cell_);
  if (tile_cells > 0) sort_by_tile(sorted, points, static_cast<double>(tile_cells) * cell_);
  for (std::vector<float>* each : {&x_, &y_, &z_}) each->resize(n + kPad, kInfinity);
  if (rows) rows->resize(n);
  std::vector<Range> found;
  std::uint32_t row = 0;
  const auto too_far = static_cast<float>(cell_ * double(kAxis - 2));
  bool wide = false;
  for (std::size_t k = 0; k < sorted.runs.size(); ++k) {
    const CellRun& run = sorted.runs[k];
    if (k == 0 || run.key != sorted.runs[k - 1].key) found.push_back({row, row});
    for (std::uint32_t i = run.begin; i < run.end; ++i, ++row) {
      const float* p = points + 3 * static_cast<std::size_t>(i);
      for (int a = 0; a < 3; ++a) wide |= std::abs(p[a]) >= too_far;
      x_[row] = p[0], y_[row] = p[1], z_[row] = p[2];
      if (rows) (*rows)[row] = i;
    }
    found.back().end = row;
  }
  if (wide) throw std::invalid_argument("cloud too wide");
  fill(found);
}

void PointGrid::sort_by_tile(CellRuns& sorted, const float* points, double tile) {
  struct Group {  // of the runs of a cell
    std::int64_t y, x;
    std::size_t begin, end;
  };
  std::vector<Group> groups;
  for (std::size_t k = 0; k < sorted.runs.size(); ++k) {
    const CellRun& run = sorted.runs[k];
    if (k == 0 || run.key != sorted.runs[k - 1].key) {
      const float* p = points + 3 * static_cast<std::size_t>(run.begin);
      groups.push_back({floor_of(p[1] / tile), floor_of(p[0] / tile), k, k});
    }
    groups.back().end = k + 1;
  }
  std::stable_sort(groups.begin(), groups.end(), [](const Group& a, const Group& b) {
    return a.y != b.y ? a.y < b.y : a.x < b.x;
  });
  std::vector<CellRun> runs;
  runs.reserve(sorted.runs.size());
  for (const Group& group : groups) {
    for (std::size_t k = group.begin; k < group.end; ++k) runs.push_back(sorted.runs[k]);
  }
  sorted.runs.swap(runs);
}

void PointGrid::fill(const std::vector<Range>& found) {
  std::vector<std::uint64_t> blocks, bits;  // of each cell
  for (const Range& range : found) {
    std::int64_t c[3];
    const Point p = (*this)[range.begin];
    for (int a = 0; a < 3; ++a) c[a] = floor_of(p[a] / cell_);
    blocks.push_back(key(c[0] >> kShift, c[1] >> kShift, c[2] >> kShift));
    bits.push_back(bit(c[0], c[1], c[2]));
  }
  std::vector<std::uint64_t> distinct = blocks;
  std::sort(distinct.begin(), distinct.end());
  const auto count = std::unique(distinct.begin(), distinct.end()) - distinct.begin();
  std::size_t capacity = 16;
  while (capacity < 2 * static_cast<std::size_t>(count)) capacity *= 2;
  table_.assign(capacity, Block{0, 0, 0});
  for (std::size_t i = 0; i < found.size(); ++i) {
    Block& block = table_[slot_of(blocks[i])];
    block.key = blocks[i];
    block.cells |= bits[i];
  }
  std::uint32_t first = 0;
  for (Block& block : table_) {
    block.first = first;
    first += static_cast<std::uint32_t>(ones(block.cells));
  }
  ranges_.resize(found.size());
  for (std::size_t i = 0; i < found.size(); ++i) {
    const Block& block = table_[slot_of(blocks[i])];
    ranges_[block.first + ones(block.cells & (bits[i] - 1))] = found[i];
  }
}

template <typename Bound, typename Take>
void PointGrid::visit_cells(const Point& p, double radius, const Bound& bound,
                            const Take& take) const {
  std::int64_t low[3], high[3], own[3];
  if (!reach(p, radius, low, high)) return;
  for (int a = 0; a < 3; ++a) own[a] = floor_of(p[a] * per_metre_);
  Cells cells(*this, low);
  const auto visit = [&](std::int64_t x, std::int64_t y, std::int64_t z) {
    if (const Range* range = cells.find(x, y, z)) take(*range, key(x, y, z));
  };
  visit(own[0], own[1], own[2]);
  for (std::int64_t x = low[0]; x <= high[0]; ++x) {
    const double across = gap(x, own[0], p[0]);
    for (std::int64_t y = low[1]; y <= high[1]; ++y) {
      const double level = across + gap(y, own[1], p[1]);
      if (level > kMargin * bound()) continue;
      for (std::int64_t z = low[2]; z <= high[2]; ++z) {
        if (x == own[0] && y == own[1] && z == own[2]) continue;
        if (level + gap(z, own[2], p[2]) > kMargin * bound()) continue;
        visit(x, y, z);
      }
    }
  }
}

std::size_t PointGrid::within(const Point& p, double radius, float distance2,
                              std::uint32_t* found) const {
  std::int64_t low[3], high[3];
  if (!reach(p, radius, low, high)) return 0;
  std::size_t count = 0;
  const Kernels& kernels = best_kernels();
  const PointArrays points = {x_.data(), y_.data(), z_.data()};
  Cells cells(*this, low);
  for (std::int64_t x = low[0]; x <= high[0]; ++x) {
    for (std::int64_t y = low[1]; y <= high[1]; ++y) {
      for (std::int64_t z = low[2]; z <= high[2]; ++z) {
        const Range* range = cells.find(x, y, z);
        if (range == nullptr) continue;
        count += kernels.near_points(points, p.data(), distance2, range->begin, range->end,
                                     found + count);
      }
    }
  }
  return count;
}

// Vectors that reach past the end of a cell read other points: those are no nearer than the
// nearest.
float PointGrid::nearest_squared(const Point& p, float limit) const {
  const double radius = std::sqrt(static_cast<double>(limit)) * (1.0 + 1e-6);
  const Place place(p);
  float best = limit * 2.0f;
  visit_cells(
      p, radius, [&] { return std::min(best, limit); },
      [&](const Range& range, std::uint64_t) {
        Floats least = all(best);
        for (std::size_t i = range.begin; i < range.end; i += kLanes) {
          const Floats squared = place.squared(&x_[i], &y_[i], &z_[i]);
          least = squared < least ? squared : least;
        }
        for (std::size_t k = 0; k < kLanes; ++k) best = std::min(best, least[k]);
      });
  return best;
}

bool PointGrid::is_near(const Point& p, float limit) const {
  const double radius = std::sqrt(static_cast<double>(limit)) * (1.0 + 1e-6);
  const Place place(p);
  const Floats most = all(limit);
  bool near = false;
  visit_cells(
      p, radius, [&] { return near ? -1.0f : limit; },
      [&](const Range& range, std::uint64_t) {
        for (std::size_t i = range.begin; i < range.end && !near; i += kLanes) {
          near = any(place.squared(&x_[i], &y_[i], &z_[i]) <= most);
        }
      });
  return near;
}

PointGrid::Nearest PointGrid::nearest(const Point& p, float limit) const {
  const float most = limit * limit;
  const Place place(p);
  Nearest found{kNone, most, most};
  std::uint64_t cell = 0;  // of the point that was found
  visit_cells(
      p, limit, [&] { return found.next; },
      [&](const Range& range, std::uint64_t at) {
        for (std::size_t begin = range.begin; begin < range.end; begin += kLanes) {
          const Floats squared = place.squared(&x_[begin], &y_[begin], &z_[begin]);
          if (!any(squared <= all(found.next))) continue;
          const std::size_t count = std::min(kLanes, range.end - begin);
          for (std::size_t k = 0; k < count; ++k) {
            const float d = squared[k];
            const bool tie = d == found.squared && (found.point == kNone || at < cell);
            if (!(d < found.squared) && !tie) {
              found.next = std::min(found.next, d);
              continue;
            }
            found = {static_cast<std::uint32_t>(begin + k), d, found.squared};
            cell = at;
          }
        }
      });
  return found;
}

double PointGrid::clearance(const Point& p, double radius) const {
  std::int64_t low[3], high[3];
  if (!reach(p, radius, low, high)) return 0.0;
  double least = cell_ + radius;
  for (int a = 0; a < 3; ++a) {  // what lies in other cells is not looked at
    const double first = static_cast<double>(low[a]) * cell_;
    const double last = static_cast<double>(high[a] + 1) * cell_;
    least = std::min({least, p[a] - first, last - p[a]});
  }
  const Place place(p);
  Floats squared = all(kInfinity);
  visit_cells(
      p, radius, [] { return kInfinity; },
      [&](const Range& range, std::uint64_t) {
        for (std::size_t i = range.begin; i < range.end; i += kLanes) {
          const Floats each = place.squared(&x_[i], &y_[i], &z_[i]);
          squared = each < squared ? each : squared;
        }
      });
  for (std::size_t k = 0; k < kLanes; ++k) {
    least = std::min(least, std::sqrt(static_cast<double>(squared[k])));
  }
  return std::max(least, 0.0);
}

}  // namespace segloc
