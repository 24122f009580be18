// Geometric consistency: matches whose centroids keep their distances under a rigid motion.
#pragma once

#include <cstddef>
#include <cstdint>
#include <vector>

#include "common/rigid.h"

namespace segloc {

// Largest number of partners of a pair in a set, for matches that are all consistent.
constexpr std::size_t kMostPartners = 512;

struct ConsistencyOptions {
  // Their values have one home: ConsistencyConfig of the Python package.
  double resolution;  // lengths of an edge in the query and in the map differ by no more, metres
  std::size_t min_size;
  std::size_t max_sets;
};

struct ConsistentSet {
  std::vector<std::size_t> members;  // matches, in the order in which they joined
  Rigid T;                           // target = T(source), fitted to all members
};

// Pairs k = 0 .. n-1, best first: source[k] and target[k], (n, 3) row-major; object[k] is what the
// source is a part of, and no set holds two pairs of one object, nor of one target_id. Returns sets
// that are consistent pair by pair, largest first.
//
// A set grows from a pair by the one that is consistent with most of those that may still join.
// Every pair starts a set unless it belongs to one already; those that are consistent with most
// others start first. Pairs are compared only with those that may be near enough in the target.
std::vector<ConsistentSet> consistent_sets(const double* source, const double* target,
                                           const std::int64_t* object,
                                           const std::int64_t* target_id, std::size_t n,
                                           const ConsistencyOptions& options);

}  // namespace segloc
