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
constexpr std::size_t kTileFloats = 2048;    // 8 KiB: thresholds fall soon, and all stays in L1

// The points of a tile as the scan reads them: one dimension after another. The last vectors are
// filled up with points at infinity.
void pack(const float* points, std::size_t count, std::size_t dim, std::size_t lanes,
          float* tile) {
  for (std::size_t i = 0; i < count; ++i) {
    float* column = tile + i / lanes * dim * lanes + i % lanes;
    for (std::size_t d = 0; d < dim; ++d) column[d * lanes] = points[i * dim + d];
  }
  for (std::size_t i = count; i < padded(count, lanes); ++i) {
    float* column = tile + i / lanes * dim * lanes + i % lanes;
    for (std::size_t d = 0; d < dim; ++d) {
      column[d * lanes] = std::numeric_limits<float>::infinity();
    }
  }
}

struct Points {
  const float* values;  // (count, dim)
  std::size_t count;
  std::size_t dim;
};

struct Candidate {
  double distance2;
  uint32_t index;
  bool operator<(const Candidate& other) const {
    return distance2 < other.distance2 || (distance2 == other.distance2 && index < other.index);
  }
};

// The best points so far of one query. The scan proposes candidates by distances in float, with a
// margin for what rounding can do; in the end they are ranked in double.
class Selection {
 public:
  Selection(std::size_t columns, std::size_t tile_points)
      : columns_(columns),
        indices_(3 * columns + 2 * tile_points),
        distances2_(indices_.size()),
        sorted_(indices_.size()),
        ranked_(indices_.size()) {}

  void start(const float* query) {
    query_ = query;
    count_ = 0;
    threshold_ = std::numeric_limits<float>::infinity();
  }
  void offer(KnnScan& scan, std::size_t slot) {
    scan.queries[slot] = query_;
    scan.thresholds[slot] = threshold_;
    scan.candidates[slot] = indices_.data();
    scan.distances2[slot] = distances2_.data();
    scan.counts[slot] = count_;
  }
  // After a tile: drops what is too far, once there is enough for that to pay.
  void take(std::size_t count, const Points& database) {
    count_ = count;
    if (count_ < 2 * columns_) return;
    std::copy_n(distances2_.begin(), count_, sorted_.begin());
    const auto last = sorted_.begin() + static_cast<std::ptrdiff_t>(columns_ - 1);
    std::nth_element(sorted_.begin(), last, sorted_.begin() + static_cast<std::ptrdiff_t>(count_));
    bound(*last);
    std::size_t kept = 0;
    for (std::size_t c = 0; c < count_; ++c) {
      indices_[kept] = indices_[c];
      distances2_[kept] = distances2_[c];
      kept += distances2_[c] <= threshold_;
    }
    count_ = kept;
    if (count_ >= 2 * columns_) rank(database);  // very many at nearly the same distance
  }
  void finish(const Points& database, int64_t* indices, float* distances) {
    rank(database);
    std::sort(ranked_.begin(), ranked_.begin() + static_cast<std::ptrdiff_t>(count_));
    for (std::size_t c = 0; c < count_; ++c) {
      indices[c] = ranked_[c].index;
      distances[c] = static_cast<float>(std::sqrt(ranked_[c].distance2));
    }
  }

 private:
  void bound(double distance2) {
    constexpr double kMargin = 1.0 + 1e-4, kTiny = 1e-37;
    threshold_ = static_cast<float>(distance2 * kMargin + kTiny);
  }
  // Keeps the best `columns`, compared exactly.
  void rank(const Points& database) {
    std::size_t n = 0;
    for (std::size_t c = 0; c < count_; ++c) {
      if (indices_[c] >= database.count) continue;  // padding of the last tile
      const float* point = database.values + indices_[c] * database.dim;
      double sum = 0;
      for (std::size_t d = 0; d < database.dim; ++d) {
        const double difference = double{query_[d]} - double{point[d]};
        sum += difference * difference;
      }
      ranked_[n++] = {sum, indices_[c]};
    }
    const auto begin = ranked_.begin(), end = begin + static_cast<std::ptrdiff_t>(n);
    if (n > columns_) {
      std::nth_element(begin, begin + static_cast<std::ptrdiff_t>(columns_ - 1), end);
      bound(ranked_[columns_ - 1].distance2);
    }
    count_ = std::min(n, columns_);
    for (std::size_t c = 0; c < count_; ++c) {
      indices_[c] = ranked_[c].index;
      distances2_[c] = static_cast<float>(ranked_[c].distance2);
    }
  }

  std::size_t columns_, count_ = 0;
  std::vector<uint32_t> indices_;
  std::vector<float> distances2_, sorted_;
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
  const Points points{database, database_count, dim};
  parallel_for(query_count, kQueryBatch, threads, [&](std::size_t begin, std::size_t end, int) {
    std::vector<Selection> selections(end - begin, Selection(columns, tile_points));
    for (std::size_t q = begin; q < end; ++q) selections[q - begin].start(queries + q * dim);
    for (std::size_t t = 0; t < tiles; ++t) {
      const std::size_t first = t * tile_points;
      const std::size_t blocks =
          (std::min(tile_points, database_count - first) + lanes - 1) / lanes;
      for (std::size_t group = 0; group < selections.size(); group += kGroup) {
        const std::size_t count = std::min(kGroup, selections.size() - group);
        KnnScan scan;
        for (std::size_t i = 0; i < kGroup; ++i) {  // a short group repeats its last query
          selections[group + std::min(i, count - 1)].offer(scan, i);
          if (i >= count) scan.thresholds[i] = -1.0f;
        }
        k.knn_scan(packed.data() + t * tile_size, blocks, dim, static_cast<uint32_t>(first), scan);
        for (std::size_t i = 0; i < count; ++i) selections[group + i].take(scan.counts[i], points);
      }
    }
    for (std::size_t q = begin; q < end; ++q) {
      selections[q - begin].finish(points, indices + q * columns, distances + q * columns);
    }
  });
}

}  // namespace segloc
