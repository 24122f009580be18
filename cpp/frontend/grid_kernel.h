// Nearest points of a grid to many places.
#pragma once

#include "frontend/grid_cells.h"
#include "simd/kernels.h"
#include "simd/simd.h"

namespace segloc {
namespace SEGLOC_ISA {
namespace {

constexpr size_t kPlaces = 64;              // that are looked up together
constexpr float kRoundedUp = 1.0f + 1e-4f;  // of squared distances in single precision

// Along each axis of places: the cell, the side of its nearer neighbour, and the squared distances
// to that and to the other one, rounded down.
struct PlaceCells {
  int32_t cell[3 * kPlaces], side[3 * kPlaces];
  float near[3 * kPlaces], far[3 * kPlaces];
};

// Places out of reach are moved to the edge, where no point is near them. No branches: the compiler
// turns the loops into vectors.
inline void find_cells(const GridCells& grid, const float* places, size_t values, PlaceCells& at) {
  constexpr double origin = static_cast<double>(kGridAxis), edge = 2.0 * origin - 2.0;
  constexpr float slack = 1e-6f;
  const double per_metre = grid.per_metre;
  const auto width = static_cast<float>(grid.cell);
  float inside[3 * kPlaces];
  for (size_t i = 0; i < values; ++i) {
    double v = static_cast<double>(places[i]) * per_metre + origin;
    v = v < edge ? v : edge;
    v = v > 2.0 ? v : 2.0;
    const auto cell = static_cast<int32_t>(v);
    at.cell[i] = cell - static_cast<int32_t>(kGridAxis);
    inside[i] = static_cast<float>(v - static_cast<double>(cell));
  }
  for (size_t i = 0; i < values; ++i) {
    const float from_low = inside[i], from_high = 1.0f - from_low;
    at.side[i] = from_low < from_high ? -1 : 1;
    const float gap = (from_low < from_high ? from_low : from_high) - slack;
    const float near = (gap > 0.0f ? gap : 0.0f) * width, far = (1.0f - 3.0f * slack - gap) * width;
    at.near[i] = near * near;
    at.far[i] = far * far;
  }
}

// Finds cells, of which one after another mostly share a block.
struct BlockFinder {
  explicit BlockFinder(const GridCells& from) : grid(from) {}
  const GridRange* find(int64_t x, int64_t y, int64_t z) {
    const uint64_t key = grid_key(x >> kBlockShift, y >> kBlockShift, z >> kBlockShift);
    if (key != known) {
      known = key;
      block = grid.blocks + grid_slot(grid.blocks, grid.bits, key);
    }
    return range_in(*block, grid.ranges, grid_bit(x, y, z));
  }

  const GridCells& grid;
  const GridBlock* block = nullptr;
  uint64_t known = ~uint64_t{0};
};

// The cells around one place. Calls take(range, key) for those that may hold a point as near as
// take.bound(), squared, its own first. Returns what is no farther than any cell left out.
template <typename Take>
inline float visit_around(const GridCells& grid, const PlaceCells& at, size_t place, Take& take) {
  int32_t cells[3][3];
  float gaps[3][3];
  for (size_t a = 0; a < 3; ++a) {
    const size_t i = 3 * place + a;
    cells[a][0] = at.cell[i], cells[a][1] = at.cell[i] + at.side[i];
    cells[a][2] = at.cell[i] - at.side[i];
    gaps[a][0] = 0.0f, gaps[a][1] = at.near[i], gaps[a][2] = at.far[i];
  }
  BlockFinder blocks(grid);
  float left = static_cast<float>(grid.cell * grid.cell);  // cells two away
  const auto leave = [&](float gap) { left = gap < left ? gap : left; };
  for (int x = 0; x < 3; ++x) {
    if (gaps[0][x] > take.bound()) {
      leave(gaps[0][x]);
      break;
    }
    for (int y = 0; y < 3; ++y) {
      const float level = gaps[0][x] + gaps[1][y];
      if (level > take.bound()) {
        leave(level);
        break;
      }
      for (int z = 0; z < 3; ++z) {
        const float gap = level + gaps[2][z];
        if (gap > take.bound()) {
          leave(gap);
          break;
        }
        const int64_t cx = cells[0][x], cy = cells[1][y], cz = cells[2][z];
        const GridRange* range = blocks.find(cx, cy, cz);
        if (range != nullptr) take(*range, grid_key(cx, cy, cz));
      }
    }
  }
  return left;
}

// Calls body(place, cells, index) for each place; what it will read of its own cell is fetched.
template <typename Body>
inline void each_place(const GridCells& grid, const float* places, size_t count,
                       const Body& body) {
  for (size_t begin = 0; begin < count; begin += kPlaces) {
    const size_t few = count - begin < kPlaces ? count - begin : kPlaces;
    PlaceCells at;
    find_cells(grid, places + 3 * begin, 3 * few, at);
    uint64_t keys[kPlaces];
    for (size_t k = 0; k < few; ++k) {
      const int32_t* c = at.cell + 3 * k;
      keys[k] = grid_key(c[0] >> kBlockShift, c[1] >> kBlockShift, c[2] >> kBlockShift);
      prefetch(grid.blocks + first_slot(keys[k], grid.bits));
    }
    const GridRange* ranges[kPlaces];
    for (size_t k = 0; k < few; ++k) {
      const int32_t* c = at.cell + 3 * k;
      const GridBlock& block = grid.blocks[grid_slot(grid.blocks, grid.bits, keys[k])];
      ranges[k] = range_in(block, grid.ranges, grid_bit(c[0], c[1], c[2]));
      if (ranges[k] != nullptr) prefetch(ranges[k]);
    }
    for (size_t k = 0; k < few; ++k) {
      if (ranges[k] == nullptr) continue;
      const uint32_t first = ranges[k]->begin;
      prefetch(grid.x + first);
      prefetch(grid.y + first);
      prefetch(grid.z + first);
    }
    for (size_t k = 0; k < few; ++k) body(places + 3 * (begin + k), at, k, begin + k);
  }
}

struct PlaceVec {
  explicit PlaceVec(const float* p) : x(broadcast(p[0])), y(broadcast(p[1])), z(broadcast(p[2])) {}
  // No fused products: every instruction set must find the same points.
  Vec squared(const GridCells& grid, size_t i) const {
    const Vec dx = load(grid.x + i) - x, dy = load(grid.y + i) - y, dz = load(grid.z + i) - z;
    return dx * dx + dy * dy + dz * dz;
  }
  Vec x, y, z;
};

// Calls take(i, hits) for vectors of points, of which a bit is set for each within the distance,
// cell by cell along x, y and z.
template <typename Take>
inline void visit_within(const GridCells& grid, const PlaceCells& at, size_t index,
                         const float* place, float distance2, const Take& take) {
  int32_t low[3], high[3];
  for (size_t a = 0; a < 3; ++a) {
    const size_t i = 3 * index + a;
    const int32_t near = at.near[i] <= kRoundedUp * distance2 ? at.side[i] : 0;
    const int32_t far = at.far[i] <= kRoundedUp * distance2 ? -at.side[i] : 0;
    low[a] = at.cell[i] + (near < far ? near : far);
    high[a] = at.cell[i] + (near < far ? far : near);
  }
  const PlaceVec centre(place);
  const Vec limit = broadcast(distance2);
  BlockFinder blocks(grid);
  for (int32_t x = low[0]; x <= high[0]; ++x) {
    for (int32_t y = low[1]; y <= high[1]; ++y) {
      for (int32_t z = low[2]; z <= high[2]; ++z) {
        const GridRange* range = blocks.find(x, y, z);
        if (range == nullptr) continue;
        for (size_t i = range->begin; i < range->end; i += kWidth) {
          uint32_t hits = less_equal(centre.squared(grid, i), limit);
          if (range->end - i < size_t{kWidth}) hits &= (1u << (range->end - i)) - 1u;
          take(i, hits);
        }
      }
    }
  }
}

void sums_within(const GridCells& grid, const float* places, size_t count, float distance2,
                 PointSums* sums) {
  const auto body = [&](const float* p, const PlaceCells& at, size_t k, size_t index) {
    PointSums sum = {};
    const double cx = p[0], cy = p[1], cz = p[2];
    visit_within(grid, at, k, p, distance2, [&](size_t first, uint32_t hits) {
      sum.count += static_cast<uint32_t>(count_bits(hits));
      for (; hits != 0; hits &= hits - 1) {
        const size_t i = first + lowest_bit(hits);
        const double x = static_cast<double>(grid.x[i]) - cx;
        const double y = static_cast<double>(grid.y[i]) - cy;
        const double z = static_cast<double>(grid.z[i]) - cz;
        sum.first[0] += x, sum.first[1] += y, sum.first[2] += z;
        sum.second[0] += x * x, sum.second[1] += x * y, sum.second[2] += x * z;
        sum.second[3] += y * y, sum.second[4] += y * z, sum.second[5] += z * z;
      }
    });
    sums[index] = sum;
  };
  each_place(grid, places, count, body);
}

// Vectors that reach past the end of a cell read other points: those are no nearer than the
// nearest.
struct LeastDistance {
  LeastDistance(const GridCells& from, const float* p, float most, float suffices)
      : grid(from), place(p), limit(most), enough(suffices) {}
  float bound() const {
    return least <= enough ? -1.0f : kRoundedUp * (least < limit ? least : limit);
  }
  void operator()(const GridRange& range, uint64_t) {
    Vec lanes = place.squared(grid, range.begin);
    for (size_t i = range.begin + kWidth; i < range.end; i += kWidth) {
      lanes = min(place.squared(grid, i), lanes);
    }
    const float found = reduce_min(lanes);
    least = found < least ? found : least;
  }

  const GridCells& grid;
  PlaceVec place;
  float limit, enough, least = kInfinity;
};

void nearest_squared(const GridCells& grid, const float* places, size_t count, float limit,
                     float enough, float* squared) {
  each_place(grid, places, count,
             [&](const float* place, const PlaceCells& at, size_t k, size_t index) {
               LeastDistance least(grid, place, limit, enough);
               visit_around(grid, at, k, least);
               squared[index] = least.least;
             });
}

// Of points that are as near: the one in the cell of the least key, and in it the first.
struct NearestPoint {
  NearestPoint(const GridCells& from, const float* p, float most, float around)
      : grid(from), place(p), limit(most), lead(around) {}

  float bound() const {
    const float most = least < limit ? least : limit;
    return kRoundedUp * (most > lead ? most : lead);
  }
  Vec squared(size_t i, size_t end) const {
    Vec each = place.squared(grid, i);
    if (end - i < size_t{kWidth}) {
      each = choose(broadcast(static_cast<float>(end - i)), load(kLanes), each,
                    broadcast(kInfinity));
    }
    return each;
  }
  void operator()(const GridRange& range, uint64_t key) {
    Vec lanes = broadcast(kInfinity);
    for (size_t i = range.begin; i < range.end; i += kWidth) {
      const Vec each = squared(i, range.end);
      lanes = min(each, lanes);
      second = min(max(each, first), second);
      first = min(each, first);
    }
    const float found = reduce_min(lanes);
    if (!(found < least) && !(found == least && key < home_key)) return;
    least = found, home = range, home_key = key;
  }
  GridNearest found(float left) const {
    if (!(least <= limit)) return {kNoPoint, kInfinity, least < left ? least : left};
    const uint32_t same = equal(first, broadcast(least));
    float next = least;
    if ((same & (same - 1)) == 0) {
      next = reduce_min(min(choose_equal(first, broadcast(least), broadcast(kInfinity), first),
                            second));
      next = left < next ? left : next;
    }
    size_t i = home.begin;
    uint32_t hits = 0;
    while ((hits = equal(place.squared(grid, i), broadcast(least))) == 0) i += kWidth;
    return {static_cast<uint32_t>(i + lowest_bit(hits)), least, next};
  }

  static constexpr float kLanes[16] = {0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15};
  const GridCells& grid;
  PlaceVec place;
  float limit, lead, least = kInfinity;
  Vec first = broadcast(kInfinity), second = broadcast(kInfinity);
  GridRange home = {0, 0};
  uint64_t home_key = 0;
};
constexpr float NearestPoint::kLanes[16];

void nearest_points(const GridCells& grid, const float* places, size_t count, float limit,
                    float lead, GridNearest* found) {
  each_place(grid, places, count,
             [&](const float* place, const PlaceCells& at, size_t k, size_t index) {
               NearestPoint nearest(grid, place, limit, lead);
               const float left = visit_around(grid, at, k, nearest);
               found[index] = nearest.found(left);
             });
}

}  // namespace
}  // namespace SEGLOC_ISA
}  // namespace segloc
