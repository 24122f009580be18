#include "pose/consistency.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <map>
#include <numeric>
#include <utility>

#include "common/portability.h"

namespace segloc {
namespace {

// Where everything is consistent with everything, the best of a pair's partners do.
constexpr std::size_t kMostPartners = 512;

struct Pair {
  std::array<double, 3> source, target;
  std::int64_t object, target_id;
};

double squared_length(const std::array<double, 3>& a, const std::array<double, 3>& b) {
  const double x = a[0] - b[0], y = a[1] - b[1], z = a[2] - b[2];
  return x * x + y * y + z * z;
}

std::size_t bits_in(std::uint64_t word) {
  return count_bits(static_cast<std::uint32_t>(word)) +
         count_bits(static_cast<std::uint32_t>(word >> 32));
}

// |sqrt(a) - sqrt(b)| <= r, without roots.
bool as_long(double a, double b, double r) {
  const double rest = a + b - r * r;
  return rest <= 0.0 || rest * rest <= 4.0 * a * b;
}

class Grower {
 public:
  Grower(std::vector<Pair> pairs, const ConsistencyOptions& options)
      : pairs_(std::move(pairs)), options_(options) {
    sort_into_cells();
  }

  // All pairs that are consistent with pair k, and how many.
  std::size_t partners_of(std::size_t k, std::vector<std::size_t>& partners) const {
    partners.clear();
    const auto [x, y] = cell_of(pairs_[k]);
    for (std::int64_t i = x - 1; i <= x + 1; ++i) {
      for (std::int64_t j = y - 1; j <= y + 1; ++j) {
        const auto found = cells_.find({i, j});
        if (found == cells_.end()) continue;
        for (const std::size_t other : found->second) {
          if (consistent(pairs_[k], pairs_[other])) partners.push_back(other);
        }
      }
    }
    return partners.size();
  }

  // The set that grows from pair k.
  std::vector<std::size_t> grown(std::size_t k) {
    partners_of(k, partners_);
    std::sort(partners_.begin(), partners_.end());
    if (partners_.size() > kMostPartners) partners_.resize(kMostPartners);
    const std::size_t count = partners_.size(), words = (count + 63) / 64;
    if (count + 1 < options_.min_size) return {};
    fill_rows(words);
    std::vector<std::uint64_t> open(words, ~std::uint64_t{0});
    if (count % 64) open.back() = (std::uint64_t{1} << count % 64) - 1;
    std::vector<std::size_t> members = {k};
    for (std::size_t left = count; left;) {
      const std::size_t next = most_connected(open, words);
      members.push_back(partners_[next]);
      left = 0;
      for (std::size_t w = 0; w < words; ++w) {
        open[w] &= rows_[next * words + w];
        left += bits_in(open[w]);
      }
      if (members.size() + left < options_.min_size) return {};
    }
    return members;
  }

 private:
  bool consistent(const Pair& a, const Pair& b) const {
    return a.object != b.object && a.target_id != b.target_id &&
           as_long(squared_length(a.source, b.source), squared_length(a.target, b.target),
                   options_.resolution);
  }

  // Cells as wide as the longest edge that a pair of sources can have: partners are in the next.
  void sort_into_cells() {
    if (pairs_.empty()) return;
    std::array<double, 3> low = pairs_[0].source, high = low;
    for (const Pair& pair : pairs_) {
      for (int a = 0; a < 3; ++a) {
        low[a] = std::min(low[a], pair.source[a]);
        high[a] = std::max(high[a], pair.source[a]);
      }
    }
    width_ = std::sqrt(squared_length(low, high)) + options_.resolution;
    for (std::size_t k = 0; k < pairs_.size(); ++k) cells_[cell_of(pairs_[k])].push_back(k);
  }

  std::pair<std::int64_t, std::int64_t> cell_of(const Pair& pair) const {
    return {static_cast<std::int64_t>(std::floor(pair.target[0] / width_)),
            static_cast<std::int64_t>(std::floor(pair.target[1] / width_))};
  }

  void fill_rows(std::size_t words) {
    rows_.assign(partners_.size() * words, 0);
    for (std::size_t i = 0; i < partners_.size(); ++i) {
      for (std::size_t j = 0; j < i; ++j) {
        if (!consistent(pairs_[partners_[i]], pairs_[partners_[j]])) continue;
        rows_[i * words + j / 64] |= std::uint64_t{1} << j % 64;
        rows_[j * words + i / 64] |= std::uint64_t{1} << i % 64;
      }
    }
  }

  // Of those that may join, the one that leaves most others; of equals the first.
  std::size_t most_connected(const std::vector<std::uint64_t>& open, std::size_t words) const {
    std::size_t best = 0, most = 0;
    bool any = false;
    for (std::size_t w = 0; w < words; ++w) {
      for (std::uint64_t bits = open[w]; bits; bits &= bits - 1) {
        const std::size_t k = 64 * w + lowest_bit(bits);
        std::size_t left = 0;
        for (std::size_t v = 0; v < words; ++v) {
          left += bits_in(open[v] & rows_[k * words + v]);
        }
        if (any && left <= most) continue;
        any = true, most = left, best = k;
      }
    }
    return best;
  }

  std::vector<Pair> pairs_;
  ConsistencyOptions options_;
  double width_ = 1.0;
  std::map<std::pair<std::int64_t, std::int64_t>, std::vector<std::size_t>> cells_;
  std::vector<std::size_t> partners_;  // of the pair that grows
  std::vector<std::uint64_t> rows_;    // which of them are consistent, a bit each
};

// Targets may lie far from the origin: only their differences count.
std::vector<Pair> centred(const double* source, const double* target, const std::int64_t* object,
                          const std::int64_t* target_id, std::size_t n) {
  std::vector<Pair> pairs(n);
  for (std::size_t k = 0; k < n; ++k) {
    for (int a = 0; a < 3; ++a) {
      pairs[k].source[a] = source[3 * k + a];
      pairs[k].target[a] = target[3 * k + a] - target[a];
    }
    pairs[k].object = object[k];
    pairs[k].target_id = target_id[k];
  }
  return pairs;
}

}  // namespace

std::vector<ConsistentSet> consistent_sets(const double* source, const double* target,
                                           const std::int64_t* object,
                                           const std::int64_t* target_id, std::size_t n,
                                           const ConsistencyOptions& options) {
  Grower grower(centred(source, target, object, target_id, n), options);
  std::vector<std::size_t> degrees(n), seeds(n), partners;
  for (std::size_t k = 0; k < n; ++k) degrees[k] = grower.partners_of(k, partners);
  std::iota(seeds.begin(), seeds.end(), std::size_t{0});
  std::stable_sort(seeds.begin(), seeds.end(),
                   [&](std::size_t a, std::size_t b) { return degrees[a] > degrees[b]; });
  std::vector<ConsistentSet> sets;
  std::vector<bool> taken(n, false);
  for (const std::size_t seed : seeds) {
    if (degrees[seed] + 1 < options.min_size) break;
    if (taken[seed]) continue;
    std::vector<std::size_t> members = grower.grown(seed);
    for (const std::size_t k : members) taken[k] = true;
    if (!members.empty()) sets.push_back({std::move(members), {}});
  }
  std::stable_sort(sets.begin(), sets.end(), [](const ConsistentSet& a, const ConsistentSet& b) {
    return a.members.size() > b.members.size();
  });
  if (sets.size() > options.max_sets) sets.resize(options.max_sets);
  for (ConsistentSet& set : sets) set.T = fit_rigid(source, target, set.members, false);
  return sets;
}

}  // namespace segloc
