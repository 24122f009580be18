#include "knn.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <vector>

#include "aligned.h"
#include "parallel.h"

namespace segloc {
namespace {

constexpr std::size_t kGroup = 4;            // queries that a scan takes together
constexpr std::size_t kQueryBatch = 16;      // queries that share a tile while it is in cache
constexpr std::size_t kTileFloats = 8192;    // 32 KiB

// The points of a tile as the scan reads them: one dimension after another.
void pack(const float* points, std::size_t count, std::size_t dim, std::size_t lanes,
          float* tile) {
  for (std::size_t i = 0; i < count; ++i) {
    float* column = tile + i / lanes * dim * lanes + i % lanes;
    for (std::size_t d = 0; d < dim; ++d) column[d * lanes] = points[i * dim + d];
  }
}

struct Candidate {
  double distance2;
  uint32_t index;
  bool operator<(const Candidate& other) const {
    return distance2 < other.distance2 || (distance2 == other.distance2 && index < other.index);
  }
};

// The best points so far of one query. The scan proposes candidates by float distances; here they
// are ranked in double, and the margin of the threshold covers what rounding can do.
class Selection {
 public:
  Selection(std::size_t columns, std::size_t tile_points)
      : columns_(columns), buffer_(2 * columns + 2 * tile_points), ranked_(buffer_.size()) {}

  void start(const float* query) {
    query_ = query;
    count_ = 0;
    threshold_ = std::numeric_limits<float>::infinity();
  }
  // After a tile: keeps the best once there are enough for that to pay.
  void settle(const float* database, std::size_t database_count, std::size_t dim) {
    const bool unbounded = std::isinf(threshold_);
    if (count_ >= 2 * columns_ || (unbounded && count_ >= columns_)) {
      rank(database, database_count, dim);
    }
  }
  // Ranks the candidates and keeps the best `columns`, unsorted.
  void rank(const float* database, std::size_t database_count, std::size_t dim) {
    std::size_t n = 0;
    for (std::size_t c = 0; c < count_; ++c) {
      if (buffer_[c] >= database_count) continue;  // padding of the last tile
      const float* point = database + buffer_[c] * dim;
      double sum = 0;
      for (std::size_t d = 0; d < dim; ++d) {
        const double difference = double{query_[d]} - double{point[d]};
        sum += difference * difference;
      }
      ranked_[n++] = {sum, buffer_[c]};
    }
    count_ = std::min(n, columns_);
    const auto begin = ranked_.begin(), end = begin + static_cast<std::ptrdiff_t>(n);
    if (n > columns_) {
      std::nth_element(begin, begin + static_cast<std::ptrdiff_t>(columns_ - 1), end);
    }
    double worst = 0;
    for (std::size_t c = 0; c < count_; ++c) {
      buffer_[c] = ranked_[c].index;
      worst = std::max(worst, ranked_[c].distance2);
    }
    if (count_ == columns_) {
      constexpr double kMargin = 1.0 + 1e-4, kTiny = 1e-37;
      threshold_ = static_cast<float>(worst * kMargin + kTiny);
    }
  }
  void finish(const float* database, std::size_t database_count, std::size_t dim,
              int64_t* indices, float* distances) {
    rank(database, database_count, dim);
    std::sort(ranked_.begin(), ranked_.begin() + static_cast<std::ptrdiff_t>(count_));
    for (std::size_t c = 0; c < count_; ++c) {
      indices[c] = ranked_[c].index;
      distances[c] = static_cast<float>(std::sqrt(ranked_[c].distance2));
    }
  }

  const float* query() const { return query_; }
  float threshold() const { return threshold_; }
  uint32_t* candidates() { return buffer_.data(); }
  std::size_t count() const { return count_; }
  void set_count(std::size_t count) { count_ = count; }

 private:
  std::size_t columns_, count_ = 0;
  std::vector<uint32_t> buffer_;
  std::vector<Candidate> ranked_;
  const float* query_ = nullptr;
  float threshold_ = 0;
};

}  // namespace

void nearest_descriptors(const float* queries, std::size_t query_count, const float* database,
                         std::size_t database_count, std::size_t dim, std::size_t columns, Isa isa,
                         int threads, int64_t* indices, float* distances) {
  if (query_count == 0 || columns == 0) return;
  const Kernels& k = kernels(isa);
  const std::size_t lanes = 2 * k.width;
  const std::size_t tile_points = std::max(lanes, kTileFloats / dim / lanes * lanes);
  const std::size_t tiles = (database_count + tile_points - 1) / tile_points;
  const std::size_t tile_size = tile_points * dim;
  AlignedFloats packed(tiles * tile_size);
  parallel_for(tiles, 4, threads, [&](std::size_t begin, std::size_t end, int) {
    for (std::size_t t = begin; t < end; ++t) {
      const std::size_t first = t * tile_points;
      pack(database + first * dim, std::min(tile_points, database_count - first), dim, lanes,
           packed.data() + t * tile_size);
    }
  });
  parallel_for(query_count, kQueryBatch, threads, [&](std::size_t begin, std::size_t end, int) {
    std::vector<Selection> selections(kQueryBatch, Selection(columns, tile_points));
    for (std::size_t q = begin; q < end; ++q) selections[q - begin].start(queries + q * dim);
    for (std::size_t t = 0; t < tiles; ++t) {
      const std::size_t first = t * tile_points;
      const std::size_t points = std::min(tile_points, database_count - first);
      for (std::size_t group = begin; group < end; group += kGroup) {
        KnnScan scan;
        const std::size_t count = std::min(kGroup, end - group);
        for (std::size_t i = 0; i < kGroup; ++i) {  // a short group repeats its last query
          Selection& s = selections[group - begin + std::min(i, count - 1)];
          scan.queries[i] = s.query();
          scan.thresholds[i] = i < count ? s.threshold() : -1.0f;
          scan.candidates[i] = s.candidates();
          scan.counts[i] = s.count();
        }
        k.knn_scan(packed.data() + t * tile_size, (points + lanes - 1) / lanes, dim,
                   static_cast<uint32_t>(first), scan);
        for (std::size_t i = 0; i < count; ++i) {
          Selection& s = selections[group - begin + i];
          s.set_count(scan.counts[i]);
          s.settle(database, database_count, dim);
        }
      }
    }
    for (std::size_t q = begin; q < end; ++q) {
      selections[q - begin].finish(database, database_count, dim, indices + q * columns,
                                   distances + q * columns);
    }
  });
}

}  // namespace segloc
