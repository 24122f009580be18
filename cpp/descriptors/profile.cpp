#include "descriptors/profile.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <vector>

#include "common/parallel.h"
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

// Moments of the points of one slice of a segment.
struct Slice {
  float count, mean[2], spread[2], top;

  Slice(const SliceLanes& sums, std::size_t lane) : count(sums.count[lane]), top(sums.top[lane]) {
    for (std::size_t d = 0; d < 2; ++d) {
      mean[d] = count > 0 ? sums.sum[d][lane] / count : 0.0f;
      const float variance = count > 0 ? sums.squares[d][lane] / count - mean[d] * mean[d] : 0.0f;
      spread[d] = std::sqrt(std::max(variance, 0.0f));
    }
  }
};

// Up to kLanes segments at a time.
class Batch {
 public:
  Batch(const Kernels& kernels, std::size_t count)
      : kernels_(kernels), count_(count), rows_(3 * kRows), xyz_(3 * count), numbers_(count) {}

  void write(const float* prepared, const float* heights, std::size_t clouds, float* output) {
    heights_ = heights, clouds_ = clouds, output_ = output;
    for (std::size_t i = 0; i < count_; ++i) {
      for (std::size_t d = 0; d < 3; ++d) {
        Row& row = xyz_[d * count_ + i];
        for (std::size_t lane = 0; lane < clouds; ++lane) {
          row[lane] = prepared[3 * (count_ * lane + i) + d];
        }
      }
    }
    for (std::size_t d = 0; d < 3; ++d) {
      kernels_.axis_statistics(coordinate(d)->data(), count_, axes_[d]);
    }
    for (std::size_t lane = 0; lane < clouds; ++lane) write_size(lane);
    write_layers();
    write_sections();
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

  // Axis `along` is cut into equal parts; a and b are measured.
  template <std::size_t Slices>
  std::array<SliceLanes, Slices> sliced(std::size_t along, std::size_t a, std::size_t b) {
    const AxisLanes& axis = axes_[along];
    const Row span =
        each_lane([&](std::size_t k) { return std::max(axis.high[k] - axis.low[k], kLeast); });
    const SliceTask task = {coordinate(along)->data(),
                            {coordinate(a)->data(), coordinate(b)->data()},
                            axis.low,
                            span.data(),
                            {axes_[a].mean, axes_[b].mean},
                            count_,
                            Slices};
    std::array<SliceLanes, Slices> sums;
    kernels_.slice_sums(task, numbers_.front().data(), sums.data());
    return sums;
  }

  void write_layers() {
    const auto total = static_cast<float>(count_);
    const std::array<SliceLanes, kLayers> layers = sliced<kLayers>(2, 0, 1);
    for (std::size_t lane = 0; lane < clouds_; ++lane) {
      float* to = out(lane) + kSlices;
      for (const SliceLanes& sums : layers) {
        const Slice s(sums, lane);
        const std::array<float, 7> numbers = {
            s.count / total,        s.mean[0],           s.mean[1],
            std::abs(s.mean[0]),    std::abs(s.mean[1]), log_length(s.spread[0]),
            log_length(s.spread[1])};
        to = std::copy(numbers.begin(), numbers.end(), to);
      }
    }
  }

  void write_sections() {
    const auto total = static_cast<float>(count_);
    const std::array<SliceLanes, kSections> sections = sliced<kSections>(0, 1, 2);
    for (std::size_t lane = 0; lane < clouds_; ++lane) {
      float* to = out(lane) + kSlices + 7 * kLayers;
      for (const SliceLanes& sums : sections) {
        const Slice s(sums, lane);
        const std::array<float, 6> numbers = {s.count / total, s.mean[0],
                                              s.mean[1],       s.spread[0],
                                              s.spread[1],     s.count > 0 ? s.top : 0.0f};
        to = std::copy(numbers.begin(), numbers.end(), to);
      }
    }
  }

  // Evenly spaced order statistics of `count` rows, mapped; `padded` is a power of two, up to which
  // rows are written.
  template <typename Map>
  void marks(Row* rows, std::size_t first, std::size_t number, std::size_t count,
             std::size_t padded, Map&& map) {
    for (std::size_t i = count; i < padded; ++i) {
      rows[i].fill(std::numeric_limits<float>::infinity());
    }
    kernels_.sort_lanes(rows->data(), padded);
    for (std::size_t lane = 0; lane < clouds_; ++lane) {
      for (std::size_t k = 0; k < number; ++k) {
        const std::size_t rank = (k * (count - 1) + (number - 1) / 2) / (number - 1);
        out(lane)[first + k] = map(lane, rows[rank][lane]);
      }
    }
  }

  void write_quantiles() {
    const auto length = [](std::size_t, float v) { return log_length(v); };
    const auto square = [](std::size_t, float v) { return log_length(std::sqrt(v)); };
    const std::size_t count = std::min(count_, kSorted);
    const Row *x = coordinate(0), *y = coordinate(1), *z = coordinate(2);
    const float *mean_x = axes_[0].mean, *mean_y = axes_[1].mean;
    const auto write = [&](std::size_t k, auto&& row, auto&& map) {
      for (std::size_t i = 0; i < count; ++i) rows_[i] = row(i);
      marks(rows_.data(), kQuantiles + k * kMarks, kMarks, count, kSorted, map);
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
    const auto off = [](const Row* values, const float* mean) {
      return [values, mean](std::size_t i) {
        return each_lane([&](std::size_t k) { return std::abs(values[i][k] - mean[k]); });
      };
    };
    write(2, off(x, mean_x), length);
    write(3, off(y, mean_y), length);
  }

  void write_distances() {
    const auto square = [](std::size_t, float v) { return log_length(std::sqrt(v)); };
    const auto metres = [](std::size_t, float v) { return v; };
    const float* const xyz[3] = {coordinate(0)->data(), coordinate(1)->data(),
                                 coordinate(2)->data()};
    Row *space = rows_.data(), *flat = space + kRows, *rise = flat + kRows;
    kernels_.pair_distances(xyz, kPairedPoints, space->data(), flat->data(), rise->data());
    marks(space, kDistances, kPairMarks, kPairs, kRows, square);
    marks(flat, kDistances + kPairMarks, kPairMarks, kPairs, kRows, square);
    marks(rise, kDistances + 2 * kPairMarks, kMarks, kPairs, kRows, metres);
  }

  const Kernels& kernels_;
  std::size_t count_, clouds_ = 0;
  const float* heights_ = nullptr;
  float* output_ = nullptr;
  std::vector<Row> rows_, xyz_, numbers_;  // what is sorted; coordinates; slices of the points
  std::array<AxisLanes, 3> axes_;
};

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
