// The nearest rows of one query, while a scan proposes them.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <limits>
#include <vector>

#include "common/portability.h"
#include "proposals/matching/descriptor_rows.h"
#include "simd/kernels.h"

namespace segloc {

// Squared distances of four rows, each summed in order: a sum waits for each of its additions, four
// do not wait for each other.
inline void squared_distances(const float* query, const float* const rows[4], std::size_t dim,
                              double sums[4]) {
  double sum[4] = {0.0, 0.0, 0.0, 0.0};
  for (std::size_t d = 0; d < dim; ++d) {
    for (int r = 0; r < 4; ++r) {
      const double difference = double{query[d]} - double{rows[r][d]};
      sum[r] += difference * difference;
    }
  }
  std::copy_n(sum, 4, sums);
}

template <typename Value>
void prefetch_row(const Value* row, std::size_t dim) {
  constexpr std::size_t kLine = 64 / sizeof(Value);
  for (std::size_t d = 0; d < dim; d += kLine) prefetch(row + d);
}

struct Points {
  const DescriptorRows& rows;
  const uint32_t* ids;  // row at each packed position
};

struct Candidate {
  double distance2;
  uint32_t id, position;
  bool operator<(const Candidate& other) const {
    return distance2 < other.distance2 || (distance2 == other.distance2 && id < other.id);
  }
};

// The best points so far of one query. The scan proposes candidates by distances in float, with a
// margin for what rounding can do; in the end they are ranked in double.
class Selection {
 public:
  Selection(std::size_t columns, std::size_t block_points)
      : columns_(columns),
        indices_(3 * columns + 2 * block_points),
        distances2_(indices_.size()),
        sorted_(indices_.size()),
        ranked_(indices_.size()) {}

  // What one takes, about.
  static std::size_t bytes(std::size_t columns, std::size_t block_points) {
    constexpr std::size_t kEach = sizeof(uint32_t) + 2 * sizeof(float) + sizeof(Candidate);
    return (3 * columns + 2 * block_points) * kEach;
  }

  void start(const float* query) {
    query_ = query;
    count_ = 0;
    threshold_ = std::numeric_limits<float>::infinity();
  }
  float threshold() const { return threshold_; }  // of the squared distance
  void offer(KnnScan& scan, std::size_t slot) {
    scan.queries[slot] = query_;
    scan.thresholds[slot] = threshold_;
    scan.candidates[slot] = indices_.data();
    scan.distances2[slot] = distances2_.data();
    scan.counts[slot] = count_;
  }
  // After a block: drops what is too far, once there is enough for that to pay.
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
      indices[c] = ranked_[c].id;
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
    const std::size_t n = count_;
    for (std::size_t c = 0; c < n; ++c) {
      ranked_[c] = {0.0, database.ids[indices_[c]], indices_[c]};
    }
    measure(database.rows, n);
    const auto begin = ranked_.begin(), end = begin + static_cast<std::ptrdiff_t>(n);
    if (n > columns_) {
      std::nth_element(begin, begin + static_cast<std::ptrdiff_t>(columns_ - 1), end);
      bound(ranked_[columns_ - 1].distance2);
    }
    count_ = std::min(n, columns_);
    for (std::size_t c = 0; c < count_; ++c) {
      indices_[c] = ranked_[c].position;
      distances2_[c] = static_cast<float>(ranked_[c].distance2);
    }
  }

  // The rows are all over the database: they are prefetched.
  void measure(const DescriptorRows& database, std::size_t n) {
    constexpr std::size_t kAhead = 16;
    const auto id = [&](std::size_t c) { return ranked_[std::min(c, n - 1)].id; };
    const auto fetch = [&](std::size_t c) {
      if (database.values) {
        prefetch_row(database.values + id(c) * database.dim, database.dim);
      } else {
        prefetch_row(database.codes + id(c) * database.dim, database.dim);
      }
    };
    for (std::size_t c = 0; c < std::min(n, kAhead); ++c) fetch(c);
    for (std::size_t c = 0; c < n; c += 4) {
      const float* rows[4];
      for (std::size_t i = 0; i < 4; ++i) {
        fetch(c + kAhead + i);
        rows[i] = database.read(id(c + i), 1, decoded_[i]);
      }
      double sums[4];
      squared_distances(query_, rows, database.dim, sums);
      for (std::size_t i = 0; i < std::min<std::size_t>(4, n - c); ++i) {
        ranked_[c + i].distance2 = sums[i];
      }
    }
  }

  std::size_t columns_, count_ = 0;
  std::vector<uint32_t> indices_;
  std::vector<float> distances2_, sorted_;
  std::vector<Candidate> ranked_;
  std::vector<float> decoded_[4];
  const float* query_ = nullptr;
  float threshold_ = 0;
};

}  // namespace segloc
