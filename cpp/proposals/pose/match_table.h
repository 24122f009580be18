// The table of centroid matches that the consensus reads: an array in single precision for each
// coordinate, matches that are near each other in the map together.
#pragma once

#include <cstddef>
#include <cstdint>
#include <vector>

#include "simd/kernels.h"

namespace segloc {

constexpr std::size_t kMaxWidth = 16;  // of a vector, for any instruction set

struct MatchRange {
  std::size_t begin, end;
};

// Matches sorted by cell of the map plane. Map coordinates are relative to an origin.
struct MatchTable {
  std::vector<float> qx, qy, qz, mx, my, mz;  // a vector's width longer than the matches
  std::vector<std::uint32_t> group;           // objects of the query
  std::vector<std::uint32_t> map_segment;     // those that are matched, numbered
  std::vector<std::uint32_t> match;           // which of the given matches this is
  std::vector<std::uint64_t> keys;
  std::int64_t stride = 0;
  double cell = 0.0;              // edge of the cells, metres
  double middle[2] = {0.0, 0.0};  // of the query,
  double reach = 0.0;             // and how far its segments are from it at most
  std::size_t groups = 0, map_segments = 0;
  double farthest = 0.0;  // largest coordinate

  std::size_t size() const { return group.size(); }
  MatchArrays arrays() const { return {qx.data(), qy.data(), mx.data(), my.data()}; }
};

struct MatchInput {
  const double* query;  // (q, 3)
  std::size_t q;
  const double* map;
  const std::int64_t* mq;
  const std::int64_t* mm;
  std::size_t n;
};

// The object of each of (n, 3) query segments: those closer than `distinct` are one, like the two
// halves of a tree that is cut at two heights.
std::vector<std::uint32_t> objects_of(const double* query, std::size_t n, double distinct);

// Objects are those of `distinct` metres.
MatchTable make_match_table(const MatchInput& input, const double* origin, double distinct);

// Ranges of the table with all matches whose map segment lies within `margin` metres of any segment
// of the query at that pose, and few others.
std::vector<MatchRange> ranges_near(const MatchTable& f, const PoseTest& pose, double margin);

}  // namespace segloc
