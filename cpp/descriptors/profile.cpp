#include "descriptors/profile.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <limits>
#include <utility>
#include <vector>

#include "common/parallel.h"
#include "common/portability.h"
#include "simd/kernels.h"

namespace segloc {
namespace {

constexpr std::size_t kMarks = 9;       // quantiles of heights, radii, extents and rises
constexpr std::size_t kPairMarks = 17;  // quantiles of distances between points
constexpr std::size_t kSorted = 128;    // points that the quantiles look at
constexpr std::size_t kPairs = kPairedPoints * (kPairedPoints - 1) / 2;
constexpr std::size_t kLayers = 6;    // slices over the height, of 7 numbers each
constexpr std::size_t kSections = 8;  // slices along the major axis, of 6 numbers each

constexpr std::size_t kQuantiles = 6;  // where each part of a profile begins
constexpr std::size_t kDistances = kQuantiles + 4 * kMarks;
constexpr std::size_t kSlices = kDistances + 2 * kPairMarks + kMarks;
constexpr std::size_t kSize = kSlices + 7 * kLayers + 6 * kSections;

constexpr float kLeast = 0.05f;  // metres; lower bound of lengths

float log_length(float metres) { return std::log(std::max(metres, kLeast)); }

// Segments are measured side by side, each in a lane: loops over lanes become vector instructions.
constexpr std::size_t kLanes = kSortLanes;
using Row = std::array<float, kLanes>;

template <typename Value>
Row each_lane(Value&& value) {
  Row row;
  for (std::size_t lane = 0; lane < kLanes; ++lane) row[lane] = value(lane);
  return row;
}

// Statistics of a coordinate.
struct Axis {
  Row low, high, mean, spread;

  // Of `count` rows.
  static Axis of(const Row* values, std::size_t count) {
    Axis axis{values[0], values[0], {}, {}};
    std::array<double, kLanes> sum = {}, squares = {};
    for (std::size_t i = 0; i < count; ++i) {
      for (std::size_t lane = 0; lane < kLanes; ++lane) {
        axis.low[lane] = std::min(axis.low[lane], values[i][lane]);
        axis.high[lane] = std::max(axis.high[lane], values[i][lane]);
        sum[lane] += values[i][lane];
      }
    }
    const auto n = static_cast<double>(count);
    for (double& each : sum) each /= n;  // the means
    for (std::size_t i = 0; i < count; ++i) {
      for (std::size_t lane = 0; lane < kLanes; ++lane) {
        const double off = values[i][lane] - sum[lane];
        squares[lane] += off * off;
      }
    }
    axis.mean = each_lane([&](std::size_t k) { return static_cast<float>(sum[k]); });
    axis.spread =
        each_lane([&](std::size_t k) { return static_cast<float>(std::sqrt(squares[k] / n)); });
    return axis;
  }
};

SEGLOC_VECTOR(float, Four, 16);

// Moments of the points of one slice: their number and sums, and the sums of squares.
struct Slice {
  Four first = {0.0f, 0.0f, 0.0f, 0.0f}, second = first;
  float top = std::numeric_limits<float>::lowest();

  void add(float x, float y, float z) {
    const Four each = {1.0f, x, y, z};
    first += each;
    second += each * each;
    top = std::max(top, z);
  }
  float count() const { return first[0]; }
  float mean(std::size_t d) const { return count() > 0 ? first[1 + d] / count() : 0.0f; }
  float spread(std::size_t d) const {
    if (!(count() > 0)) return 0.0f;
    return std::sqrt(std::max(second[1 + d] / count() - mean(d) * mean(d), 0.0f));
  }
};

// Up to kLanes segments at a time.
class Batch {
 public:
  Batch(const Kernels& kernels, std::size_t count)
      : kernels_(kernels), count_(count), rows_(kRows), xyz_(3 * count) {}

  void write(const float* prepared, const float* heights, std::size_t clouds, float* output) {
    prepared_ = prepared, heights_ = heights, clouds_ = clouds, output_ = output;
    for (std::size_t i = 0; i < count_; ++i) {
      for (std::size_t d = 0; d < 3; ++d) {
        Row& row = xyz_[d * count_ + i];
        for (std::size_t lane = 0; lane < clouds; ++lane) {
          row[lane] = prepared[3 * (count_ * lane + i) + d];
        }
      }
    }
    for (std::size_t d = 0; d < 3; ++d) axes_[d] = Axis::of(coordinate(d), count_);
    for (std::size_t lane = 0; lane < clouds; ++lane) {
      write_size(lane);
      write_slices(lane);
    }
    write_quantiles();
    write_distances();
  }

 private:
  static constexpr std::size_t kRows = 512;
  static_assert(kPairs <= kRows && kSorted <= kRows);

  const Row* coordinate(std::size_t d) const { return xyz_.data() + d * count_; }
  float* out(std::size_t lane) const { return output_ + kSize * lane; }

  void write_size(std::size_t lane) const {
    for (std::size_t d = 0; d < 3; ++d) {
      out(lane)[d] = log_length(axes_[d].high[lane] - axes_[d].low[lane]);
      out(lane)[3 + d] = log_length(axes_[d].spread[lane]);
    }
  }

  // An axis is cut into equal parts.
  template <std::size_t Slices>
  std::array<Slice, Slices> sliced(std::size_t lane, std::size_t d) const {
    std::array<Slice, Slices> slices;
    const float low = axes_[d].low[lane], span = std::max(axes_[d].high[lane] - low, kLeast);
    const float mean[3] = {axes_[0].mean[lane], axes_[1].mean[lane], axes_[2].mean[lane]};
    const float* p = prepared_ + 3 * count_ * lane;
    for (const float* end = p + 3 * count_; p < end; p += 3) {
      const float share = (p[d] - low) / span;
      const auto slice = static_cast<std::size_t>(share * static_cast<float>(Slices));
      slices[std::min(slice, Slices - 1)].add(p[0] - mean[0], p[1] - mean[1], p[2] - mean[2]);
    }
    return slices;
  }

  void write_slices(std::size_t lane) const {
    const auto total = static_cast<float>(count_);
    float* to = out(lane) + kSlices;
    for (const Slice& s : sliced<kLayers>(lane, 2)) {
      const std::array<float, 7> numbers = {
          s.count() / total,      s.mean(0),           s.mean(1),
          std::abs(s.mean(0)),    std::abs(s.mean(1)), log_length(s.spread(0)),
          log_length(s.spread(1))};
      to = std::copy(numbers.begin(), numbers.end(), to);
    }
    for (const Slice& s : sliced<kSections>(lane, 0)) {
      const std::array<float, 6> numbers = {s.count() / total,
                                            s.mean(1),
                                            s.mean(2),
                                            s.spread(1),
                                            s.spread(2),
                                            s.count() > 0 ? s.top : 0.0f};
      to = std::copy(numbers.begin(), numbers.end(), to);
    }
  }

  // Evenly spaced order statistics of row(i) for i < count, mapped; `padded` is a power of two.
  template <typename Value, typename Map>
  void marks(std::size_t first, std::size_t number, std::size_t count, std::size_t padded,
             Value&& row, Map&& map) {
    for (std::size_t i = 0; i < count; ++i) rows_[i] = row(i);
    for (std::size_t i = count; i < padded; ++i) {
      rows_[i].fill(std::numeric_limits<float>::infinity());
    }
    kernels_.sort_lanes(rows_.front().data(), padded);
    for (std::size_t lane = 0; lane < clouds_; ++lane) {
      for (std::size_t k = 0; k < number; ++k) {
        const std::size_t rank = (k * (count - 1) + (number - 1) / 2) / (number - 1);
        out(lane)[first + k] = map(lane, rows_[rank][lane]);
      }
    }
  }

  void write_quantiles() {
    const auto length = [](std::size_t, float v) { return log_length(v); };
    const auto square = [](std::size_t, float v) { return log_length(std::sqrt(v)); };
    const std::size_t count = std::min(count_, kSorted);
    const Row *x = coordinate(0), *y = coordinate(1), *z = coordinate(2);
    const Row &mean_x = axes_[0].mean, &mean_y = axes_[1].mean;
    const auto write = [&](std::size_t k, auto&& row, auto&& map) {
      marks(kQuantiles + k * kMarks, kMarks, count, kSorted, row, map);
    };
    write(
        0, [&](std::size_t i) { return z[i]; },
        [&](std::size_t lane, float v) { return v + heights_[lane]; });
    write(
        1,
        [&](std::size_t i) {
          return each_lane([&](std::size_t k) {
            const float dx = x[i][k] - mean_x[k], dy = y[i][k] - mean_y[k];
            return dx * dx + dy * dy;
          });
        },
        square);
    const auto off = [](const Row* values, const Row& mean) {
      return [values, &mean](std::size_t i) {
        return each_lane([&](std::size_t k) { return std::abs(values[i][k] - mean[k]); });
      };
    };
    write(2, off(x, mean_x), length);
    write(3, off(y, mean_y), length);
  }

  void write_distances() {
    const auto square = [](std::size_t, float v) { return log_length(std::sqrt(v)); };
    const auto metres = [](std::size_t, float v) { return v; };
    const Row *x = coordinate(0), *y = coordinate(1), *z = coordinate(2);
    const auto flat = [&](std::size_t i) {
      const auto [a, b] = kPairOf[i];
      const Row &ax = x[a], &bx = x[b], &ay = y[a], &by = y[b];
      return each_lane([&](std::size_t k) {
        const float dx = ax[k] - bx[k], dy = ay[k] - by[k];
        return dx * dx + dy * dy;
      });
    };
    const auto rise = [&](std::size_t i) {
      const Row &az = z[kPairOf[i].first], &bz = z[kPairOf[i].second];
      return each_lane([&](std::size_t k) { return std::abs(az[k] - bz[k]); });
    };
    const auto space = [&](std::size_t i) {
      const Row level = flat(i), up = rise(i);
      return each_lane([&](std::size_t k) { return level[k] + up[k] * up[k]; });
    };
    marks(kDistances, kPairMarks, kPairs, kRows, space, square);
    marks(kDistances + kPairMarks, kPairMarks, kPairs, kRows, flat, square);
    marks(kDistances + 2 * kPairMarks, kMarks, kPairs, kRows, rise, metres);
  }

  using Pair = std::pair<uint8_t, uint8_t>;
  static const std::array<Pair, kPairs> kPairOf;

  static std::array<Pair, kPairs> all_pairs() {
    std::array<Pair, kPairs> pairs;
    std::size_t next = 0;
    for (uint8_t i = 0; i < kPairedPoints; ++i) {
      for (uint8_t j = 0; j < i; ++j) pairs[next++] = {i, j};
    }
    return pairs;
  }

  const Kernels& kernels_;
  std::size_t count_, clouds_ = 0;
  const float* prepared_ = nullptr;
  const float* heights_ = nullptr;
  float* output_ = nullptr;
  std::vector<Row> rows_, xyz_;  // what is sorted; the coordinates
  std::array<Axis, 3> axes_;
};

const std::array<Batch::Pair, kPairs> Batch::kPairOf = Batch::all_pairs();

}  // namespace

std::size_t profile_size() { return kSize; }

void shape_profiles(const float* prepared, const float* heights, std::size_t segments,
                    std::size_t count, int threads, float* output) {
  parallel_for(segments, kLanes, threads, [&](std::size_t begin, std::size_t end, int) {
    Batch batch(best_kernels(), count);
    for (std::size_t first = begin; first < end; first += kLanes) {
      batch.write(prepared + 3 * count * first, heights + first, std::min(kLanes, end - first),
                  output + kSize * first);
    }
  });
}

}  // namespace segloc
