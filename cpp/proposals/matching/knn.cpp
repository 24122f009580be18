#include "proposals/matching/knn.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <utility>

#include "common/parallel.h"
#include "proposals/matching/knn_selection.h"

namespace segloc {
namespace {

constexpr std::size_t kGroup = 4;          // queries that a scan takes together
constexpr std::size_t kQueryBatch = 16;    // queries that share a tile while it is in cache
constexpr std::size_t kTileFloats = 2048;  // 8 KiB: thresholds fall soon, and all stays in L1

constexpr std::size_t kSelectedBytes = std::size_t{1} << 28;  // of a worker's selections, at most

constexpr std::size_t kSampled = 32;  // points a centre that k-means looks at
constexpr int kRounds = 8;            // of k-means

}  // namespace

DescriptorIndex::DescriptorIndex(const float* database, std::size_t count, std::size_t dim,
                                 std::size_t lists, Isa isa, int threads)
    : database_(database),
      count_(count),
      dim_(dim),
      kernels_(kernels(isa)),
      lanes_(2 * kernels_.width) {
  divide(std::max<std::size_t>(1, std::min(lists, count)), threads);
}

// k-means on evenly spaced rows, and then every row to the centre that is nearest to it.
void DescriptorIndex::divide(std::size_t lists, int threads) {
  std::vector<uint32_t> list_of(count_, 0);
  if (lists == 1) {
    centres_.assign(dim_, 0.0f);
    return pack(list_of, threads);
  }
  const std::size_t sampled = std::min(count_, kSampled * lists);
  std::vector<float> sample(sampled * dim_);
  for (std::size_t i = 0; i < sampled; ++i) {
    std::copy_n(database_ + i * count_ / sampled * dim_, dim_, sample.data() + i * dim_);
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
  coarse_ =
      std::make_unique<DescriptorIndex>(centres_.data(), lists, dim_, 1, kernels_.isa, threads);
  const std::vector<int64_t> at = nearest(database_, count_);
  for (std::size_t i = 0; i < count_; ++i) list_of[i] = static_cast<uint32_t>(at[i]);
  pack(list_of, threads);
}

// Rows as the scan reads them: blocks of `lanes_` rows, one dimension after another. Lists are
// filled up with rows at infinity.
void DescriptorIndex::pack(const std::vector<uint32_t>& list_of, int threads) {
  const std::size_t lists = centres_.size() / dim_;
  sizes_.assign(lists, 0);
  for (const uint32_t list : list_of) ++sizes_[list];
  starts_.assign(1, 0);
  for (const std::size_t size : sizes_) starts_.push_back(starts_.back() + padded(size, lanes_));
  ids_.assign(starts_.back(), static_cast<uint32_t>(count_));
  std::vector<std::size_t> next(starts_.begin(), starts_.end() - 1);
  for (std::size_t i = 0; i < count_; ++i) ids_[next[list_of[i]]++] = static_cast<uint32_t>(i);
  packed_ = AlignedFloats(starts_.back() * dim_);
  parallel_for(starts_.back() / lanes_, 64, threads, [&](std::size_t begin, std::size_t end, int) {
    for (std::size_t i = begin * lanes_; i < end * lanes_; ++i) {
      float* column = packed_.data() + i / lanes_ * dim_ * lanes_ + i % lanes_;
      const float* row = ids_[i] < count_ ? database_ + ids_[i] * dim_ : nullptr;
      for (std::size_t d = 0; d < dim_; ++d) {
        column[d * lanes_] = row ? row[d] : std::numeric_limits<float>::infinity();
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

void DescriptorIndex::search(const float* queries, std::size_t query_count, std::size_t columns,
                             std::size_t probes, int threads, int64_t* indices,
                             float* distances) const {
  if (query_count == 0 || columns == 0) return;
  const std::size_t tile_points = std::max(lanes_, kTileFloats / dim_ / lanes_ * lanes_);
  const Points points{database_, count_, dim_, ids_.data()};
  const auto workers = static_cast<std::size_t>(resolve_threads(threads));
  // Queries that probe the same list share its tiles while they are in cache.
  const std::size_t wanted =
      lists() == 1 ? kQueryBatch : std::max(kQueryBatch, (query_count + workers - 1) / workers);
  const std::size_t fits = kSelectedBytes / Selection::bytes(columns, tile_points);
  const std::size_t batch = std::clamp<std::size_t>(wanted, 1, std::max<std::size_t>(fits, 1));
  parallel_for(query_count, batch, threads, [&](std::size_t begin, std::size_t end, int) {
    std::vector<Selection> selections(end - begin, Selection(columns, tile_points));
    // For each list who probes it: those that are nearest to it, in a first pass, so that later
    // candidates meet a bound; then the others.
    std::vector<std::vector<uint32_t>> visits(2 * lists());
    const auto chosen = probed(queries + begin * dim_, end - begin, columns, probes);
    for (std::size_t q = 0; q < end - begin; ++q) {
      selections[q].start(queries + (begin + q) * dim_);
      for (std::size_t rank = 0; rank < chosen[q].size(); ++rank) {
        visits[chosen[q][rank] + (rank == 0 ? 0 : lists())].push_back(uint32_t(q));
      }
    }
    for (std::size_t visit = 0; visit < visits.size(); ++visit) {
      const std::size_t list = visit % lists();
      for (std::size_t at = starts_[list]; at < starts_[list + 1]; at += tile_points) {
        const std::size_t blocks = std::min(tile_points, starts_[list + 1] - at) / lanes_;
        for (std::size_t group = 0; group < visits[visit].size(); group += kGroup) {
          const uint32_t* members = visits[visit].data() + group;
          const std::size_t count = std::min(kGroup, visits[visit].size() - group);
          KnnScan scan;
          for (std::size_t i = 0; i < kGroup; ++i) {  // a short group repeats its last query
            selections[members[std::min(i, count - 1)]].offer(scan, i);
            if (i >= count) scan.thresholds[i] = -1.0f;
          }
          kernels_.knn_scan(packed_.data() + at * dim_, blocks, dim_, static_cast<uint32_t>(at),
                            scan);
          for (std::size_t i = 0; i < count; ++i) {
            selections[members[i]].take(scan.counts[i], points);
          }
        }
      }
    }
    for (std::size_t q = begin; q < end; ++q) {
      selections[q - begin].finish(points, indices + q * columns, distances + q * columns);
    }
  });
}

void nearest_descriptors(const float* queries, std::size_t query_count, const float* database,
                         std::size_t database_count, std::size_t dim, std::size_t columns, Isa isa,
                         int threads, int64_t* indices, float* distances) {
  const DescriptorIndex index(database, database_count, dim, 1, isa, threads);
  index.search(queries, query_count, columns, 1, threads, indices, distances);
}

}  // namespace segloc
