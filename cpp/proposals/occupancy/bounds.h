// Upper bounds of a query's score in windows of an occupancy map, and the cost of its free cells.
#pragma once

#include <cstddef>
#include <cstdint>
#include <tuple>
#include <vector>

#include "proposals/occupancy/pose_search.h"

namespace segloc {

struct Branch {
  float score;
  std::uint32_t held;  // without what free places cost
  std::uint32_t yaw;   // of the widest windows, a turn
  std::int32_t x, y;  // first cell of its window

  bool operator<(const Branch& other) const {  // the better one first
    return std::tie(other.score, yaw, y, x) < std::tie(score, other.yaw, other.y, other.x);
  }
};

// The widest windows are scored at the middle of each turn, of some headings that follow one
// another: what they hold differs little between these.
constexpr std::size_t kTurned = 4;
inline std::size_t turns(const SearchLimits& limits, std::size_t turned = kTurned) {
  return (limits.yaws + turned - 1) / turned;
}

double angle(double k, const SearchLimits& limits);

// Places about the sensor at each turn of `turned` headings, as steps from a cell: in cells, and of
// a flat level in bytes, if the area has such.
class Steps {
 public:
  Steps(const SearchArea& area, const std::vector<float>& places, const SearchLimits& limits,
        std::size_t turned = 1);

  std::size_t size() const { return size_; }
  const std::int32_t* offsets(std::size_t yaw) const { return offsets_.data() + 2 * size_ * yaw; }
  const std::int32_t* flat(std::size_t yaw) const { return steps_.data() + size_ * yaw; }

 private:
  std::size_t size_;
  std::vector<std::int32_t> offsets_, steps_;
};

// Scores of windows of one search.
class Bounds {
 public:
  // The area must outlive this.
  Bounds(const SearchArea& area, const PlanarView& view, const SearchLimits& limits);

  // No score is higher.
  std::size_t most() const { return most_; }
  // What the windows of some runs, of the highest level, hold of some columns at a turn, and the
  // same less the cost.
  void all(const std::vector<std::size_t>& runs, std::size_t turn, std::vector<std::uint16_t>& held,
           std::vector<std::uint16_t>& scores) const;
  // Scores the four quarters of one window by some of what is seen, with the cost or without.
  void roughly(int level, Branch* quarters, bool costly) const;
  // Scores a window so scored by all that is seen.
  void finish(int level, Branch& branch, bool costly) const;
  // The most that a pose within a window can hold.
  std::uint32_t held(int level, const Branch& b) const { return one(level, b, 0, slices_.size()); }
  // What a finished window holds, less the cost.
  float score(int level, const Branch& b) const;

 private:
  std::uint32_t one(int level, const Branch& b, std::size_t begin, std::size_t end) const;
  void four(int level, Branch* quarters, std::size_t end) const;
  // Loss, as a share of the largest possible score.
  float cost(int level, const Branch& b, const Steps& free) const;

  const SearchArea& area_;
  int leaf_level_;
  std::vector<std::uint8_t> slices_;
  std::size_t first_, wide_;  // columns scored first, spread over all, and in the widest windows
  std::size_t most_, most_first_, most_wide_;  // slices of all columns, and of these
  Steps columns_, turned_;   // the latter for the highest level
  std::vector<Steps> free_;  // some, of each level
  Steps all_free_;           // of the leaves
};

}  // namespace segloc
