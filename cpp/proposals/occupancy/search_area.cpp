// A search area laid out, and its widest windows scored.
#include <algorithm>
#include <cmath>
#include <stdexcept>
#include <utility>

#include "proposals/occupancy/pose_search.h"

namespace segloc {
namespace {

constexpr std::size_t kMostCells = std::size_t{1} << 26, kMostFlat = std::size_t{1} << 25;

}  // namespace

SearchArea::SearchArea(const OccupancyPyramid& map, const std::int32_t* roots, std::size_t r,
                       double range)
    : map_(map), range_(range) {
  if (r == 0) return;
  std::vector<std::pair<std::int32_t, std::int32_t>> sorted;
  std::int32_t high[2] = {roots[0], roots[1]}, low[2] = {roots[0], roots[1]};
  for (std::size_t i = 0; i < 2 * r; ++i) {
    high[i % 2] = std::max(high[i % 2], roots[i]);
    low[i % 2] = std::min(low[i % 2], roots[i]);
  }
  for (std::size_t i = 0; i < r; ++i) sorted.push_back({roots[2 * i + 1], roots[2 * i]});
  std::sort(sorted.begin(), sorted.end());
  const double side = map.cell() * double(1 << (map.levels() - 1));
  const auto pad = static_cast<std::int32_t>(std::ceil(range / side)) + 1;
  low_x_ = low[0] - pad;
  low_y_ = low[1] - pad;
  wide_ = static_cast<std::size_t>(high[0] + pad + kSpan - low_x_);
  high_ = static_cast<std::size_t>(high[1] + pad + 1 - low_y_);
  const int shift = 2 * (map.levels() - 1);
  if ((wide_ << shift) > kMostCells || (wide_ * high_ << shift) > kMostCells) {
    throw std::invalid_argument("roots lie too far apart");
  }
  lay_out();
  lay_flat();
  for (const auto& [y, x] : sorted) {
    const bool inside = !runs_.empty() && runs_.back().y == y && x - runs_.back().x < kSpan;
    if (!inside) runs_.push_back({x, y, 0, place_of(x, y)});
    runs_.back().members |= 1u << (x - runs_.back().x);
  }
}

void SearchArea::lay_out() {
  const int top = map_.levels() - 1;
  const std::int32_t side = 1 << top;
  image_.reserve(wide_ * high_ << (2 * top));
  middles_.reserve(wide_ * high_ << (2 * top));
  for (std::int32_t py = 0; py < side; ++py) {
    for (std::int32_t px = 0; px < side; ++px) {
      for (std::size_t y = 0; y < high_; ++y) {
        const std::int32_t cell_y = (low_y_ + static_cast<std::int32_t>(y)) * side + py;
        for (std::size_t x = 0; x < wide_; ++x) {
          const std::int32_t cell_x = (low_x_ + static_cast<std::int32_t>(x)) * side + px;
          image_.push_back(map_.at(top, cell_x, cell_y));
          middles_.push_back(is_blocked(cell_x + side / 2, cell_y + side / 2));
        }
      }
    }
  }
}

// The lower levels as plain images, which are read faster than the pyramid's tiles, if they are
// small.
void SearchArea::lay_flat() {
  const int top = map_.levels() - 1;
  const std::size_t cells = wide_ * high_ << (2 * top);
  if (cells * static_cast<std::size_t>(top) > kMostFlat) return;
  const auto high = static_cast<std::int32_t>(high_ << top);
  for (int level = 0; level < top; ++level) {
    flat_.emplace_back();
    flat_.back().reserve(cells);
    for (std::int32_t v = low_y_ * (1 << top), y = v; y < v + high; ++y) {
      for (std::int32_t u = low_x_ * (1 << top), x = u; x < u + wide(); ++x) {
        flat_.back().push_back(level == 0 ? is_blocked(x, y) : map_.at(level, x, y));
      }
    }
  }
}

void SearchArea::add_up(const std::vector<std::uint8_t>& image,
                        const std::vector<std::size_t>& runs, const std::int32_t* offsets,
                        const std::uint8_t* slices, std::size_t m,
                        std::vector<std::uint16_t>& scores) const {
  const int top = map_.levels() - 1;
  const std::int32_t last = (1 << top) - 1;
  std::vector<std::size_t> columns(m), begins;
  for (std::size_t i = 0; i < m; ++i) {
    const std::int32_t x = offsets[2 * i], y = offsets[2 * i + 1];
    const auto place = static_cast<std::size_t>(((y & last) << top) | (x & last));
    const std::ptrdiff_t shift =
        std::ptrdiff_t{y >> top} * static_cast<std::ptrdiff_t>(wide_) + (x >> top);
    columns[i] = place * wide_ * high_ + static_cast<std::size_t>(shift);
  }
  for (const std::size_t run : runs) begins.push_back(runs_[run].at);
  const std::vector<std::uint8_t> all(slices ? 0 : m, std::uint8_t{0xff});
  scores.assign(runs.size() * kRun, 0);
  kernels(parse_isa("auto")).add_slices(image.data(), columns.data(), slices ? slices : all.data(),
                                        m, begins.data(), begins.size(), scores.data());
}

}  // namespace segloc
