// Height of a cloud, cell by cell.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <limits>
#include <unordered_map>
#include <vector>

#include "common/portability.h"

namespace segloc {

// A sensor with a lower field of view sees less of trees and houses. Points above all nearby points
// of the cloud were not in view, and are not evidence for or against a pose. Neither are points in
// unmapped space, without even ground.
class ObservedHeight {
 public:
  ObservedHeight(const float* points, std::size_t n) {
    std::unordered_map<std::uint64_t, Span> own, around;
    for (std::size_t i = 0; i < n; ++i) {
      const float* p = points + 3 * i;
      if (!near(p[0], p[1])) continue;
      own[key(cell(p[0]), cell(p[1]))].add(p[2], p[2]);
    }
    for (const auto& [at, span] : own) {
      for (std::int64_t dy = -1; dy <= 1; ++dy) {
        for (std::int64_t dx = -1; dx <= 1; ++dx)
          around[key(x_of(at) + dx, y_of(at) + dy)].add(span.low, span.high);
      }
    }
    std::size_t capacity = 16;
    while (capacity < 2 * around.size()) capacity *= 2;
    table_.resize(capacity);
    for (const auto& [at, span] : around) {
      std::size_t slot = first_slot(at);
      while (!table_[slot].is_free()) slot = (slot + 1) & (capacity - 1);
      table_[slot] = {at, span};
    }
  }

  enum class View { kSeen, kTooHigh, kUnmapped };

  // Whether the cloud would have a point here if one were: not where it is higher than the cloud is
  // around it, nor where the cloud has nothing at all. Near the ground it would.
  View at(float x, float y, float z) const {
    const Span* span = around(x, y);
    if (span == nullptr) return View::kUnmapped;
    const float top = std::max(span->high, span->low + kAlways) + kSlack;
    return z <= top ? View::kSeen : View::kTooHigh;
  }
  // Fetches what the others read at a place.
  void fetch(float x, float y) const {
    if (near(x, y)) prefetch(&table_[first_slot(key(cell(x), cell(y)))]);
  }
  bool is_mapped(float x, float y) const { return around(x, y) != nullptr; }

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

  struct Slot {
    std::uint64_t key = 0;
    Span span;
    bool is_free() const { return span.low > span.high; }
  };

  // Its high bits depend on all of the key.
  std::size_t first_slot(std::uint64_t key) const {
    return (key * 0x9E3779B97F4A7C15ull >> 32) & (table_.size() - 1);
  }
  const Span* around(float x, float y) const {
    if (!near(x, y)) return nullptr;
    const std::uint64_t at = key(cell(x), cell(y));
    for (std::size_t slot = first_slot(at);; slot = (slot + 1) & (table_.size() - 1)) {
      if (table_[slot].is_free()) return nullptr;
      if (table_[slot].key == at) return &table_[slot].span;
    }
  }
  static bool near(float x, float y) { return std::abs(x) < kLimit && std::abs(y) < kLimit; }
  static std::int64_t cell(float v) {
    const auto whole = static_cast<std::int64_t>(v / kCell);
    return whole - (v / kCell < static_cast<float>(whole));
  }
  static std::uint64_t key(std::int64_t x, std::int64_t y) {
    return (static_cast<std::uint64_t>(x) << 32) | (static_cast<std::uint64_t>(y) & 0xFFFFFFFFull);
  }
  static std::int64_t x_of(std::uint64_t at) { return static_cast<std::int32_t>(at >> 32); }
  static std::int64_t y_of(std::uint64_t at) {
    return static_cast<std::int32_t>(at & 0xFFFFFFFFull);
  }

  std::vector<Slot> table_;  // of cells and those about them: open addressing
};

}  // namespace segloc
