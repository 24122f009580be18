#include "proposals/pose/match_table.h"

#include <algorithm>
#include <cmath>
#include <numeric>

#include "common/cells.h"
#include "common/portability.h"

namespace segloc {
namespace {

// Numbers the distinct values in rising order.
std::size_t number(std::vector<std::uint32_t>& values) {
  std::vector<std::uint64_t> keys(values.begin(), values.end());
  std::vector<std::uint32_t> order(values.size());
  std::iota(order.begin(), order.end(), 0u);
  int bits = 1;
  const std::uint64_t largest = values.empty() ? 0 : *std::max_element(keys.begin(), keys.end());
  while ((largest >> bits) != 0) ++bits;
  radix_sort(keys, order, bits);
  std::uint32_t distinct = 0;
  for (std::size_t k = 0; k < order.size(); ++k) {
    distinct += k > 0 && keys[k] != keys[k - 1];
    values[order[k]] = distinct;
  }
  return values.empty() ? 0 : distinct + 1;
}

// Where the matched segments of the map lie, (n, 3) relative to the origin. They are all over the
// map, so they are prefetched long before they are read.
std::vector<float> matched_points(const MatchInput& in, const double* origin) {
  constexpr std::size_t kAhead = 24;
  std::vector<float> points(3 * in.n);
  for (std::size_t k = 0; k < in.n; ++k) {
    const double* later = in.map + 3 * in.mm[std::min(k + kAhead, in.n - 1)];
    prefetch(later);
    prefetch(later + 2);
    for (int a = 0; a < 3; ++a) {
      points[3 * k + a] = static_cast<float>(in.map[3 * in.mm[k] + a] - origin[a]);
    }
  }
  return points;
}

}  // namespace

std::vector<std::uint32_t> objects_of(const double* points, std::size_t n, double radius) {
  std::vector<std::uint32_t> group(n);
  std::uint32_t groups = 0;
  for (std::size_t i = 0; i < n; ++i) {
    group[i] = groups;
    for (std::size_t j = 0; j < i; ++j) {
      const double dx = points[3 * i] - points[3 * j], dy = points[3 * i + 1] - points[3 * j + 1];
      if (dx * dx + dy * dy < radius * radius) {
        group[i] = group[j];
        break;
      }
    }
    if (group[i] == groups) ++groups;
  }
  return group;
}

MatchTable make_match_table(const MatchInput& in, const double* origin, double distinct) {
  MatchTable f;
  double low[2] = {1e300, 1e300}, high[2] = {-1e300, -1e300};
  for (std::size_t i = 0; i < in.q; ++i) {
    for (int a = 0; a < 2; ++a) {
      low[a] = std::min(low[a], in.query[3 * i + a]);
      high[a] = std::max(high[a], in.query[3 * i + a]);
    }
  }
  for (int a = 0; a < 2; ++a) f.middle[a] = 0.5 * (low[a] + high[a]);
  f.reach = 0.5 * std::hypot(high[0] - low[0], high[1] - low[1]);
  f.cell = std::max(0.5 * f.reach, 1.0);
  const std::vector<float> matched = matched_points(in, origin);
  std::vector<float> plane = matched;
  for (std::size_t k = 0; k < in.n; ++k) plane[3 * k + 2] = 0.0f;
  CellOrder cells = sort_into_cells(plane.data(), in.n, f.cell);
  const std::vector<std::uint32_t> group = objects_of(in.query, in.q, distinct);
  f.keys = std::move(cells.keys);
  f.stride = cells.stride_y;
  f.groups = in.q == 0 ? 0 : 1 + *std::max_element(group.begin(), group.end());
  f.match = std::move(cells.order);
  f.group.resize(in.n);
  f.map_segment.resize(in.n);
  float farthest = 0.0f;
  for (std::vector<float>* coordinate : {&f.qx, &f.qy, &f.qz, &f.mx, &f.my, &f.mz}) {
    coordinate->resize(in.n + kMaxWidth, 0.0f);
  }
  for (std::size_t i = 0; i < in.n; ++i) {
    const std::size_t k = f.match[i];
    const double* q = in.query + 3 * in.mq[k];
    const float* m = matched.data() + 3 * k;
    f.qx[i] = static_cast<float>(q[0]);
    f.qy[i] = static_cast<float>(q[1]);
    f.qz[i] = static_cast<float>(q[2]);
    f.mx[i] = m[0];
    f.my[i] = m[1];
    f.mz[i] = m[2];
    f.group[i] = group[static_cast<std::size_t>(in.mq[k])];
    f.map_segment[i] = static_cast<std::uint32_t>(in.mm[k]);
    for (const float v : {f.qx[i], f.qy[i], f.qz[i], m[0], m[1], m[2]}) {
      farthest = std::max(farthest, std::fabs(v));
    }
  }
  f.farthest = farthest;
  f.map_segments = number(f.map_segment);
  return f;
}

std::vector<MatchRange> ranges_near(const MatchTable& f, const PoseTest& pose, double margin) {
  const double middle[2] = {
      pose.cosine * f.middle[0] - pose.sine * f.middle[1] + pose.x,
      pose.sine * f.middle[0] + pose.cosine * f.middle[1] + pose.y};
  const auto cells_to = [&](double metres) { return std::int64_t(std::floor(metres / f.cell)); };
  // The first match lies somewhere in its cell: what is n cells on is n or n + 1 numbers on.
  const auto key = static_cast<std::int64_t>(f.keys.front());
  const std::int64_t column = key % f.stride, row = key / f.stride;
  const double reach = f.reach + margin, dx = middle[0] - f.mx[0], dy = middle[1] - f.my[0];
  const std::int64_t left = std::max<std::int64_t>(column + cells_to(dx - reach), 0);
  const std::int64_t right = std::min(column + cells_to(dx + reach) + 1, f.stride - 1);
  const std::int64_t last =
      std::min(row + cells_to(dy + reach) + 1, std::int64_t(f.keys.back()) / f.stride);
  std::vector<MatchRange> ranges;
  auto begin = f.keys.begin();
  for (std::int64_t at = std::max(row + cells_to(dy - reach), row); at <= last; ++at) {
    if (left > right) break;
    begin = std::lower_bound(begin, f.keys.end(), std::uint64_t(at * f.stride + left));
    const auto end = std::upper_bound(begin, f.keys.end(), std::uint64_t(at * f.stride + right));
    if (begin != end) {
      ranges.push_back({static_cast<std::size_t>(begin - f.keys.begin()),
                        static_cast<std::size_t>(end - f.keys.begin())});
    }
    begin = end;
  }
  return ranges;
}

}  // namespace segloc
