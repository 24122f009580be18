#include "proposals/pose/consistency.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <map>
#include <numeric>
#include <utility>

#include "common/portability.h"
#include "simd/kernels.h"

namespace segloc {
namespace {

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

// What kernels may read behind the last value.
constexpr std::size_t kBehind = 15;

// Sources and targets in single precision, padded for the kernels.
class Columns {
 public:
  void resize(std::size_t count) {
    for (auto& column : columns_) column.resize(count + kBehind);
  }

  void set(std::size_t k, const Pair& pair) {
    for (int a = 0; a < 3; ++a) {
      columns_[a][k] = static_cast<float>(pair.source[a]);
      columns_[3 + a][k] = static_cast<float>(pair.target[a]);
    }
  }

  EdgeArrays arrays() const {
    const auto& c = columns_;
    return {{c[0].data(), c[1].data(), c[2].data()}, {c[3].data(), c[4].data(), c[5].data()}};
  }

 private:
  std::array<std::vector<float>, 6> columns_;
};

// Which pairs are consistent with each other: pairs whose targets lie too far apart for any edge of
// the sources are not looked at.
class Partners {
 public:
  Partners(const std::vector<Pair>& pairs, double resolution)
      : pairs_(pairs), resolution_(resolution), found_(pairs.size()) {
    sort_into_cells();
    for (std::size_t p = 0; p < order_.size(); ++p) {
      const auto [x, y] = cell_of(pairs_[order_[p]]);
      compare(p, p + 1, cells_.at({x, y}).second);
      for (const auto& next :
           {Cell{x, y + 1}, Cell{x + 1, y - 1}, Cell{x + 1, y}, Cell{x + 1, y + 1}}) {
        const auto cell = cells_.find(next);
        if (cell != cells_.end()) compare(p, cell->second.first, cell->second.second);
      }
    }
    for (auto& partners : found_) std::sort(partners.begin(), partners.end());
  }

  // Best first.
  const std::vector<std::uint32_t>& of(std::size_t k) const { return found_[k]; }

  const Pair& pair(std::size_t k) const { return pairs_[k]; }

  // What lengths in single precision may differ by, where those in double are as long.
  float loose() const { return loose_; }

  bool consistent(std::size_t i, std::size_t j) const {
    const Pair &a = pairs_[i], &b = pairs_[j];
    return a.object != b.object && a.target_id != b.target_id &&
           as_long(squared_length(a.source, b.source), squared_length(a.target, b.target),
                   resolution_);
  }

 private:
  using Cell = std::pair<std::int64_t, std::int64_t>;

  // Cells as wide as the longest edge that a pair of sources can have: partners are in the next.
  void sort_into_cells() {
    if (pairs_.empty()) return;
    std::array<double, 3> low = pairs_[0].source, high = low;
    double farthest = 0.0;
    for (const Pair& pair : pairs_) {
      for (int a = 0; a < 3; ++a) {
        low[a] = std::min(low[a], pair.source[a]);
        high[a] = std::max(high[a], pair.source[a]);
        farthest = std::max({farthest, std::fabs(pair.target[a]), std::fabs(pair.source[a])});
      }
    }
    width_ = std::sqrt(squared_length(low, high)) + resolution_;
    // Rounding of the coordinates, and of the fourth powers of lengths that are compared.
    const double rounding = 1e-5 * farthest + 1e-6 * width_ * width_ / resolution_;
    loose_ = static_cast<float>(resolution_ + rounding);
    order_.resize(pairs_.size());
    std::iota(order_.begin(), order_.end(), 0u);
    std::stable_sort(order_.begin(), order_.end(), [&](std::uint32_t i, std::uint32_t j) {
      return cell_of(pairs_[i]) < cell_of(pairs_[j]);
    });
    columns_.resize(pairs_.size());
    for (std::size_t p = 0; p < order_.size(); ++p) {
      const Pair& pair = pairs_[order_[p]];
      columns_.set(p, pair);
      const auto cell = cells_.try_emplace(cell_of(pair), p, p + 1).first;
      cell->second.second = p + 1;
    }
    maybe_.resize(pairs_.size());
  }

  Cell cell_of(const Pair& pair) const {
    return {static_cast<std::int64_t>(std::floor(pair.target[0] / width_)),
            static_cast<std::int64_t>(std::floor(pair.target[1] / width_))};
  }

  // Position p with those from begin to end: loosely in single precision, then exactly.
  void compare(std::size_t p, std::size_t begin, std::size_t end) {
    const std::size_t count =
        kernels_.like_edges(columns_.arrays(), p, loose_, begin, end, maybe_.data());
    for (std::size_t m = 0; m < count; ++m) {
      const std::uint32_t i = order_[p], j = order_[maybe_[m]];
      if (!consistent(i, j)) continue;
      if (found_[i].size() < kMostPartners) found_[i].push_back(j);
      if (found_[j].size() < kMostPartners) found_[j].push_back(i);
    }
  }

  const std::vector<Pair>& pairs_;
  double resolution_, width_ = 1.0;
  float loose_ = 0.0f;
  std::vector<std::vector<std::uint32_t>> found_;
  const Kernels& kernels_ = kernels(parse_isa("auto"));
  std::vector<std::uint32_t> order_;  // pairs by cell
  Columns columns_;                   // in that order
  std::vector<std::uint32_t> maybe_;  // positions that may be consistent with p
  std::map<Cell, std::pair<std::size_t, std::size_t>> cells_;  // first position, and past the last
};

class Grower {
 public:
  Grower(const Partners& all, std::size_t min_size) : all_(all), min_size_(min_size) {}

  // The set that grows from pair k.
  std::vector<std::size_t> grown(std::size_t k) {
    const std::vector<std::uint32_t>& partners = all_.of(k);
    const std::size_t count = partners.size(), words = (count + 63) / 64;
    if (count + 1 < min_size_) return {};
    fill_rows(partners, words);
    std::vector<std::uint64_t> open(words, ~std::uint64_t{0});
    if (count % 64) open.back() = (std::uint64_t{1} << count % 64) - 1;
    std::vector<std::size_t> members = {k};
    for (std::size_t left = count; left;) {
      const std::size_t next = most_connected(open, words);
      members.push_back(partners[next]);
      left = 0;
      for (std::size_t w = 0; w < words; ++w) {
        open[w] &= rows_[next * words + w];
        left += bits_in(open[w]);
      }
      if (members.size() + left < min_size_) return {};
    }
    return members;
  }

 private:
  void fill_rows(const std::vector<std::uint32_t>& partners, std::size_t words) {
    rows_.assign(partners.size() * words, 0);
    columns_.resize(partners.size());
    maybe_.resize(partners.size());
    for (std::size_t i = 0; i < partners.size(); ++i) columns_.set(i, all_.pair(partners[i]));
    for (std::size_t i = 0; i < partners.size(); ++i) {
      const std::size_t count =
          kernels_.like_edges(columns_.arrays(), i, all_.loose(), 0, i, maybe_.data());
      for (std::size_t m = 0; m < count; ++m) {
        const std::size_t j = maybe_[m];
        if (!all_.consistent(partners[i], partners[j])) continue;
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

  const Partners& all_;
  std::size_t min_size_;
  const Kernels& kernels_ = kernels(parse_isa("auto"));
  Columns columns_;  // of the partners
  std::vector<std::uint32_t> maybe_;
  std::vector<std::uint64_t> rows_;  // which partners of a pair are consistent, a bit each
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
  const std::vector<Pair> pairs = centred(source, target, object, target_id, n);
  const Partners partners(pairs, options.resolution);
  Grower grower(partners, options.min_size);
  std::vector<std::size_t> seeds(n);
  std::iota(seeds.begin(), seeds.end(), std::size_t{0});
  std::stable_sort(seeds.begin(), seeds.end(), [&](std::size_t a, std::size_t b) {
    return partners.of(a).size() > partners.of(b).size();
  });
  std::vector<ConsistentSet> sets;
  std::vector<bool> taken(n, false);
  for (const std::size_t seed : seeds) {
    if (partners.of(seed).size() + 1 < options.min_size) break;
    if (taken[seed]) continue;
    std::vector<std::size_t> members = grower.grown(seed);
    for (const std::size_t k : members) taken[k] = true;
    if (!members.empty()) sets.push_back({std::move(members), {}});
  }
  std::stable_sort(sets.begin(), sets.end(), [](const ConsistentSet& a, const ConsistentSet& b) {
    return a.members.size() > b.members.size();
  });
  if (sets.size() > options.max_sets) sets.resize(options.max_sets);
  for (ConsistentSet& set : sets) set.T = fit_rigid(source, target, set.members);
  return sets;
}

}  // namespace segloc
