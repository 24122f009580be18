// How high the points of a cloud are, place by place.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <limits>
#include <unordered_map>

namespace segloc {

// A sensor whose field of view ends lower than another one's sees less of trees and houses. What is
// higher than anything the cloud has nearby was not in view, and says nothing of a pose.
class ObservedHeight {
 public:
  ObservedHeight(const float* points, std::size_t n) {
    std::unordered_map<std::uint64_t, Span> own;
    for (std::size_t i = 0; i < n; ++i) {
      const float* p = points + 3 * i;
      if (!near(p[0], p[1])) continue;
      own[key(cell(p[0]), cell(p[1]))].add(p[2], p[2]);
    }
    for (const auto& [at, span] : own) {
      for (std::int64_t dy = -1; dy <= 1; ++dy) {
        for (std::int64_t dx = -1; dx <= 1; ++dx)
          around_[key(x_of(at) + dx, y_of(at) + dy)].add(span.low, span.high);
      }
    }
  }

  // Whether a point is no higher than the cloud is around it. Near the ground it always is, and so
  // it is where the cloud has nothing at all.
  bool contains(float x, float y, float z) const {
    if (!near(x, y)) return true;
    const auto found = around_.find(key(cell(x), cell(y)));
    if (found == around_.end()) return true;
    return z <= std::max(found->second.high, found->second.low + kAlways) + kSlack;
  }

 private:
  static constexpr float kCell = 4.0f, kAlways = 3.0f, kSlack = 0.5f;  // metres
  static constexpr float kLimit = 4e9f;  // metres; the numbers of cells fit 32 bits

  struct Span {
    float low = std::numeric_limits<float>::infinity(), high = -low;
    void add(float bottom, float top) {
      low = std::min(low, bottom);
      high = std::max(high, top);
    }
  };

  static bool near(float x, float y) { return std::abs(x) < kLimit && std::abs(y) < kLimit; }
  static std::int64_t cell(float v) { return static_cast<std::int64_t>(std::floor(v / kCell)); }
  static std::uint64_t key(std::int64_t x, std::int64_t y) {
    return (static_cast<std::uint64_t>(x) << 32) | (static_cast<std::uint64_t>(y) & 0xFFFFFFFFull);
  }
  static std::int64_t x_of(std::uint64_t at) { return static_cast<std::int32_t>(at >> 32); }
  static std::int64_t y_of(std::uint64_t at) {
    return static_cast<std::int32_t>(at & 0xFFFFFFFFull);
  }

  std::unordered_map<std::uint64_t, Span> around_;
};

}  // namespace segloc
