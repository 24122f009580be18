#include "proposals/matching/knn.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <numeric>
#include <utility>

#include "common/parallel.h"
#include "proposals/matching/knn_selection.h"

namespace segloc {
namespace {

constexpr std::size_t kGroup = 4;        // queries that a scan takes together
constexpr std::size_t kQueryBatch = 16;  // queries that share a block while it is in cache

constexpr std::size_t kBoxedQueries = 384;  // of a single search for which boxes pay

constexpr std::size_t kSelectedBytes = std::size_t{1} << 28;  // of a worker's selections, at most

constexpr std::size_t kSampled = 32;  // points a centre that k-means looks at
constexpr int kRounds = 8;            // of k-means

constexpr std::size_t kRead = 1 << 14;  // rows that are decoded together
constexpr uint32_t kNone = 0xFFFFFFFFu;  // padding of a list

}  // namespace

DescriptorIndex::DescriptorIndex(const DescriptorRows& database, std::size_t lists, Isa isa,
                                 int threads, bool boxes)
    : database_(database),
      count_(database.count),
      dim_(database.dim),
      boxed_(boxes),
      kernels_(kernels(isa)),
      lanes_(2 * kernels_.width) {
  divide(std::max<std::size_t>(1, std::min(lists, count_)), threads);
}

// k-means on evenly spaced rows, and then every row to the centre that is nearest to it.
void DescriptorIndex::divide(std::size_t lists, int threads) {
  std::vector<uint32_t> list_of(count_, 0);
  if (lists == 1) {
    centres_.assign(dim_, 0.0f);
    return pack(list_of, threads);
  }
  const std::size_t sampled = std::min(count_, kSampled * lists);
  std::vector<float> sample(sampled * dim_), buffer;
  for (std::size_t i = 0; i < sampled; ++i) {
    std::copy_n(database_.read(i * count_ / sampled, 1, buffer), dim_, sample.data() + i * dim_);
  }
  centres_.resize(lists * dim_);
  for (std::size_t c = 0; c < lists; ++c) {
    std::copy_n(sample.data() + c * sampled / lists * dim_, dim_, centres_.data() + c * dim_);
  }
  const auto nearest = [&](const float* rows, std::size_t n) {
    std::vector<int64_t> at(n);
    std::vector<float> distance(n);
    nearest_descriptors(rows, n, centres_.data(), lists, dim_, 1, kernels_.isa, threads, at.data(),
                        distance.data());
    return at;
  };
  for (int round = 0; round < kRounds; ++round) {
    const std::vector<int64_t> at = nearest(sample.data(), sampled);
    std::vector<double> sums(lists * dim_, 0.0);
    std::vector<std::size_t> members(lists, 0);
    for (std::size_t i = 0; i < sampled; ++i) {
      const auto c = static_cast<std::size_t>(at[i]);
      ++members[c];
      for (std::size_t d = 0; d < dim_; ++d) sums[c * dim_ + d] += sample[i * dim_ + d];
    }
    for (std::size_t c = 0; c < lists; ++c) {
      for (std::size_t d = 0; d < dim_ && members[c] != 0; ++d) {
        centres_[c * dim_ + d] = static_cast<float>(sums[c * dim_ + d] / double(members[c]));
      }
    }
  }
  coarse_ = std::make_unique<DescriptorIndex>(DescriptorRows(centres_.data(), lists, dim_), 1,
                                              kernels_.isa, threads);
  for (std::size_t begin = 0; begin < count_; begin += kRead) {
    const std::size_t n = std::min(kRead, count_ - begin);
    const std::vector<int64_t> at = nearest(database_.read(begin, n, buffer), n);
    for (std::size_t i = 0; i < n; ++i) list_of[begin + i] = static_cast<uint32_t>(at[i]);
  }
  pack(list_of, threads);
}

// Rows as the scan reads them: blocks of `lanes_` rows, one dimension after another.
void DescriptorIndex::pack(const std::vector<uint32_t>& list_of, int threads) {
  const std::size_t lists = centres_.size() / dim_;
  sizes_.assign(lists, 0);
  for (const uint32_t list : list_of) ++sizes_[list];
  starts_.assign(1, 0);
  for (const std::size_t size : sizes_) starts_.push_back(starts_.back() + padded(size, lanes_));
  ids_.assign(starts_.back(), kNone);
  std::vector<std::size_t> next(starts_.begin(), starts_.end() - 1);
  for (std::size_t i = 0; i < count_; ++i) ids_[next[list_of[i]]++] = static_cast<uint32_t>(i);
  group_starts_.assign(1, 0);
  for (std::size_t list = 0; list < lists; ++list) {
    const std::size_t blocks = (starts_[list + 1] - starts_[list]) / lanes_;
    group_starts_.push_back(group_starts_.back() + (blocks + kBoxRun - 1) / kBoxRun);
  }
  if (boxed_) axes_ = DescriptorAxes(database_);
  if (!axes_.empty()) bound(threads);
  if (database_.values) {
    packed_ = AlignedFloats(starts_.back() * dim_);
    fill(packed_.data(), database_.values, threads);
  } else {
    codes_.resize(starts_.back() * dim_);
    fill(codes_.data(), database_.codes, threads);
  }
}

template <typename Value>
void DescriptorIndex::fill(Value* packed, const Value* rows, int threads) const {
  parallel_for(starts_.back() / lanes_, 64, threads, [&](std::size_t begin, std::size_t end, int) {
    for (std::size_t i = begin * lanes_; i < end * lanes_; ++i) {
      if (ids_[i] == kNone) continue;
      Value* column = packed + i / lanes_ * dim_ * lanes_ + i % lanes_;
      const Value* row = rows + ids_[i] * dim_;
      for (std::size_t d = 0; d < dim_; ++d) column[d * lanes_] = row[d];
    }
  });
}

// Rows that lie near each other share a block.
void DescriptorIndex::bound(int threads) {
  std::vector<float> projected(count_ * kBoxAxes), buffer;
  for (std::size_t begin = 0; begin < count_; begin += kRead) {
    const std::size_t n = std::min(kRead, count_ - begin);
    float* const to = projected.data() + begin * kBoxAxes;
    farthest_ =
        std::max(farthest_, axes_.project(database_.read(begin, n, buffer), n, threads, to));
  }
  const float* const projections = projected.data();
  boxes_.resize(group_starts_.back());
  parallel_for(sizes_.size(), 1, threads, [&](std::size_t begin, std::size_t end, int) {
    for (std::size_t list = begin; list < end; ++list) {
      uint32_t* const ids = ids_.data() + starts_[list];
      order_by_place(projections, lanes_, ids, ids + sizes_[list]);
      for (std::size_t i = 0; i < sizes_[list]; ++i) {
        const std::size_t block = i / lanes_;
        boxes_.add(group_starts_[list] + block / kBoxRun, block % kBoxRun,
                   projections + std::size_t{ids[i]} * kBoxAxes);
      }
    }
  });
}

// The lists to be read for each query, the nearest first.
std::vector<std::vector<uint32_t>> DescriptorIndex::probed(const float* queries,
                                                           std::size_t query_count,
                                                           std::size_t columns,
                                                           std::size_t probes) const {
  std::vector<std::vector<uint32_t>> chosen(query_count);
  if (lists() == 1) {
    for (auto& lists : chosen) lists = {0};
    return chosen;
  }
  const auto nearest = [&](const float* rows, std::size_t n, std::size_t count) {
    std::vector<int64_t> at(n * count);
    std::vector<float> distances(n * count);
    coarse_->search(rows, n, count, 1, 1, at.data(), distances.data());
    return at;
  };
  const auto choose = [&](const int64_t* order, std::size_t count, std::size_t q) {
    std::size_t held = 0;
    chosen[q].clear();
    for (std::size_t i = 0; i < count && (i < probes || held < columns); ++i) {
      chosen[q].push_back(static_cast<uint32_t>(order[i]));
      held += sizes_[static_cast<std::size_t>(order[i])];
    }
    return held >= columns;
  };
  const std::size_t usual = std::min(std::max<std::size_t>(probes, 1), lists());
  const std::vector<int64_t> order = nearest(queries, query_count, usual);
  for (std::size_t q = 0; q < query_count; ++q) {
    if (choose(order.data() + q * usual, usual, q)) continue;
    choose(nearest(queries + q * dim_, 1, lists()).data(), lists(), q);
  }
  return chosen;
}

// The search of some queries together: those that read a block share it while it is in cache.
class DescriptorIndex::Search {
 public:
  Search(const DescriptorIndex& index, const float* queries, std::size_t count,
         std::size_t columns)
      : index_(index),
        points_{index.database_, index.ids_.data()},
        selections_(count, Selection(columns, index.lanes_)),
        near_(count * kBoxAxes),
        first_(count) {
    for (std::size_t q = 0; q < count; ++q) selections_[q].start(queries + q * index.dim_);
    if (index.axes_.empty()) return;
    const float farthest = index.axes_.project(queries, count, 1, near_.data());
    slack_ = 1e-6f * (farthest + index.farthest_);
  }

  // Reads the lists that were chosen for each query. The blocks about it come first, so that those
  // after them meet a bound.
  void read(const std::vector<std::vector<uint32_t>>& chosen, std::size_t columns) {
    const std::size_t groups = 1 + kFirstRows * columns / (kBoxRun * index_.lanes_);
    for (uint32_t q = 0; q < chosen.size(); ++q) first_[q] = first_groups(q, chosen[q][0], groups);
    std::vector<uint32_t> members(chosen.size());
    std::iota(members.begin(), members.end(), 0u);
    std::sort(members.begin(), members.end(),
              [&](uint32_t a, uint32_t b) { return first_[a].begin < first_[b].begin; });
    for (std::size_t begin = 0, end = 0; begin < members.size(); begin = end) {
      const Range& range = first_[members[begin]];
      while (end < members.size() && first_[members[end]].begin == range.begin) ++end;
      for (std::size_t group = range.begin; group < range.end; ++group) {
        for (std::size_t m = begin; m < end; ++m) enter(range.list, group, members[m], true);
        scan(range.list, group);
      }
    }
    std::vector<std::vector<uint32_t>> visits(index_.lists());
    for (uint32_t q = 0; q < chosen.size(); ++q) {
      for (const uint32_t list : chosen[q]) visits[list].push_back(q);
    }
    for (std::size_t list = 0; list < visits.size(); ++list) {
      if (visits[list].empty()) continue;
      for (std::size_t group = index_.group_starts_[list]; group < index_.group_starts_[list + 1];
           ++group) {
        for (const uint32_t q : visits[list]) {
          if (group < first_[q].begin || group >= first_[q].end) enter(list, group, q, false);
        }
        scan(list, group);
      }
    }
  }

  void finish(std::size_t q, int64_t* indices, float* distances) {
    selections_[q].finish(points_, indices, distances);
  }

 private:
  static constexpr std::size_t kFirstRows = 4;  // a neighbour wanted, before anything is skipped

  struct Range {  // of groups, in a list
    std::size_t list = 0, begin = 0, end = 0;
  };

  std::size_t blocks_of(std::size_t list, std::size_t group) const {
    const std::size_t all = (index_.starts_[list + 1] - index_.starts_[list]) / index_.lanes_;
    return std::min(kBoxRun, all - (group - index_.group_starts_[list]) * kBoxRun);
  }

  // The groups of a list about the block that is nearest to a query.
  Range first_groups(uint32_t q, std::size_t list, std::size_t groups) const {
    const std::size_t begin = index_.group_starts_[list], end = index_.group_starts_[list + 1];
    std::size_t nearest = begin;
    float least = std::numeric_limits<float>::infinity(), bounds[kBoxRun];
    for (std::size_t group = begin; group < end && !index_.axes_.empty(); ++group) {
      index_.kernels_.box_bounds(index_.boxes_.group(group), near_.data() + q * kBoxAxes, bounds);
      for (const float bound : bounds) {
        if (bound < least) least = bound, nearest = group;
      }
    }
    const std::size_t from = begin + (nearest - begin) / groups * groups;
    return {list, from, std::min(from + groups, end)};
  }

  // Enters a query at the blocks of a group that it has to read.
  void enter(std::size_t list, std::size_t group, uint32_t q, bool all) {
    const std::size_t blocks = blocks_of(list, group);
    if (all || index_.axes_.empty()) {
      for (std::size_t block = 0; block < blocks; ++block) visitors_[block].push_back(q);
      return;
    }
    const float reach = std::sqrt(selections_[q].threshold()) * (1.0f + 1e-4f) + slack_;
    float bounds[kBoxRun];
    index_.kernels_.box_bounds(index_.boxes_.group(group), near_.data() + q * kBoxAxes, bounds);
    for (std::size_t block = 0; block < blocks; ++block) {
      if (bounds[block] <= reach * reach) visitors_[block].push_back(q);
    }
  }

  // Reads the blocks of a group for those that were entered, kGroup of them together.
  void scan(std::size_t list, std::size_t group) {
    const std::size_t first = index_.starts_[list] +
                              (group - index_.group_starts_[list]) * kBoxRun * index_.lanes_;
    for (std::size_t block = 0; block < blocks_of(list, group); ++block) {
      std::vector<uint32_t>& visitors = visitors_[block];
      const std::size_t at = first + block * index_.lanes_;
      const std::size_t left = index_.starts_[list] + index_.sizes_[list] - at;
      const uint32_t points = left < 32 ? (1u << left) - 1u : ~0u;
      for (std::size_t begin = 0; begin < visitors.size(); begin += kGroup) {
        const std::size_t count = std::min(kGroup, visitors.size() - begin);
        KnnScan scan;
        scan.points = points;
        for (std::size_t i = 0; i < kGroup; ++i) {  // a short group repeats its last query
          selections_[visitors[begin + std::min(i, count - 1)]].offer(scan, i);
          if (i >= count) scan.thresholds[i] = -1.0f;
        }
        read(at, scan);
        for (std::size_t i = 0; i < count; ++i) {
          selections_[visitors[begin + i]].take(scan.counts[i], points_);
        }
      }
      visitors.clear();
    }
  }

  void read(std::size_t at, KnnScan& scan) const {
    const Kernels& kernels = index_.kernels_;
    const std::size_t dim = index_.dim_, offset = at * dim;
    const auto first = static_cast<uint32_t>(at);
    if (index_.database_.values) {
      kernels.knn_scan(index_.packed_.data() + offset, dim, first, scan);
    } else {
      const DescriptorRows& rows = index_.database_;
      kernels.knn_scan_codes({index_.codes_.data() + offset, rows.base, rows.step}, dim, first,
                             scan);
    }
  }

  const DescriptorIndex& index_;
  Points points_;
  std::vector<Selection> selections_;
  std::vector<float> near_;  // projections of the queries
  std::vector<Range> first_;
  float slack_ = 0.0f;  // what rounding can add to a projected distance
  std::vector<uint32_t> visitors_[kBoxRun];
};

void DescriptorIndex::search(const float* queries, std::size_t query_count, std::size_t columns,
                             std::size_t probes, int threads, int64_t* indices,
                             float* distances) const {
  if (query_count == 0 || columns == 0) return;
  const auto workers = static_cast<std::size_t>(resolve_threads(threads));
  const bool shared = lists() > 1 || !axes_.empty();
  const std::size_t wanted =
      shared ? std::max(kQueryBatch, (query_count + workers - 1) / workers) : kQueryBatch;
  const std::size_t fits = kSelectedBytes / Selection::bytes(columns, lanes_);
  const std::size_t batch = std::clamp<std::size_t>(wanted, 1, std::max<std::size_t>(fits, 1));
  parallel_for(query_count, batch, threads, [&](std::size_t begin, std::size_t end, int) {
    Search search(*this, queries + begin * dim_, end - begin, columns);
    search.read(probed(queries + begin * dim_, end - begin, columns, probes), columns);
    for (std::size_t q = begin; q < end; ++q) {
      search.finish(q - begin, indices + q * columns, distances + q * columns);
    }
  });
}

void nearest_descriptors(const float* queries, std::size_t query_count, const float* database,
                         std::size_t database_count, std::size_t dim, std::size_t columns, Isa isa,
                         int threads, int64_t* indices, float* distances) {
  const DescriptorIndex index(DescriptorRows(database, database_count, dim), 1, isa, threads,
                              query_count >= kBoxedQueries);
  index.search(queries, query_count, columns, 1, threads, indices, distances);
}

}  // namespace segloc
