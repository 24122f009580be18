#include "match_field.h"

#include <algorithm>
#include <cmath>

#include "cells.h"

namespace segloc {
namespace {

constexpr std::size_t kMaxWidth = 16;

// Query segments that lie close together (the same object cut at two heights) are one witness.
std::vector<std::uint32_t> group_by_distance(const double* points, std::size_t n, double radius) {
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

// Numbers the distinct values in rising order.
std::size_t number(std::vector<std::uint32_t>& values) {
  std::vector<std::uint32_t> distinct = values;
  std::sort(distinct.begin(), distinct.end());
  distinct.erase(std::unique(distinct.begin(), distinct.end()), distinct.end());
  for (std::uint32_t& value : values) {
    const auto at = std::lower_bound(distinct.begin(), distinct.end(), value);
    value = static_cast<std::uint32_t>(at - distinct.begin());
  }
  return distinct.size();
}

void pad(Field& f) {
  for (std::vector<float>* column : {&f.qx, &f.qy, &f.qz, &f.mx, &f.my, &f.mz}) {
    column->resize(f.size() + kMaxWidth, 0.0f);
  }
}

}  // namespace

Field make_field(const MatchInput& in, const double* origin, double distinct, double reach) {
  std::vector<float> plane(3 * in.n, 0.0f);
  for (std::size_t k = 0; k < in.n; ++k) {
    for (int a = 0; a < 2; ++a) {
      plane[3 * k + a] = static_cast<float>(in.map[3 * in.mm[k] + a] - origin[a]);
    }
  }
  CellOrder cells = sort_into_cells(plane.data(), in.n, reach);
  const std::vector<std::uint32_t> group = group_by_distance(in.query, in.q, distinct);
  Field f;
  f.keys = std::move(cells.keys);
  f.stride = cells.stride_y;
  f.groups = in.q == 0 ? 0 : 1 + *std::max_element(group.begin(), group.end());
  f.match = std::move(cells.order);
  for (const std::uint32_t k : f.match) {
    const double *a = in.query + 3 * in.mq[k], *b = in.map + 3 * in.mm[k];
    f.qx.push_back(static_cast<float>(a[0]));
    f.qy.push_back(static_cast<float>(a[1]));
    f.qz.push_back(static_cast<float>(a[2]));
    f.mx.push_back(static_cast<float>(b[0] - origin[0]));
    f.my.push_back(static_cast<float>(b[1] - origin[1]));
    f.mz.push_back(static_cast<float>(b[2] - origin[2]));
    f.group.push_back(group[static_cast<std::size_t>(in.mq[k])]);
    f.site.push_back(static_cast<std::uint32_t>(in.mm[k]));
  }
  for (const std::vector<float>* column : {&f.qx, &f.qy, &f.qz, &f.mx, &f.my, &f.mz}) {
    for (const float v : *column) f.farthest = std::max<double>(f.farthest, std::fabs(v));
  }
  f.sites = number(f.site);
  pad(f);
  return f;
}

void ranges_around(const Field& f, std::uint64_t key, MatchRange ranges[3]) {
  for (int dy = -1; dy <= 1; ++dy) {
    const auto row = key + static_cast<std::uint64_t>(dy * f.stride);
    const auto begin = std::lower_bound(f.keys.begin(), f.keys.end(), row - 1);
    const auto end = std::upper_bound(begin, f.keys.end(), row + 1);
    ranges[dy + 1] = {static_cast<std::size_t>(begin - f.keys.begin()),
                      static_cast<std::size_t>(end - f.keys.begin())};
  }
}

}  // namespace segloc
