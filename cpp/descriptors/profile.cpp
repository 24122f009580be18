#include "descriptors/profile.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <limits>
#include <utility>
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

constexpr float kLeast = 0.05f;  // metres; shorter lengths are not told apart

float log_length(float metres) { return std::log(std::max(metres, kLeast)); }

struct Axis {
  float low, high, mean, spread;
};

// A prepared segment, with the statistics of its coordinates.
class Cloud {
 public:
  Cloud(const float* points, std::size_t count, float height)
      : p_(points), n_(count), height_(height) {
    for (std::size_t d = 0; d < 3; ++d) axis_[d] = measure(d);
  }

  std::size_t size() const { return n_; }
  float height() const { return height_; }
  const Axis& axis(std::size_t d) const { return axis_[d]; }
  float at(std::size_t i, std::size_t d) const { return p_[3 * i + d]; }
  float centred(std::size_t i, std::size_t d) const { return at(i, d) - axis_[d].mean; }

  // The slice of a point when an axis is cut into equal parts.
  std::size_t slice(std::size_t i, std::size_t d, std::size_t slices) const {
    const float span = std::max(axis_[d].high - axis_[d].low, kLeast);
    const float share = (at(i, d) - axis_[d].low) / span;
    return std::min(static_cast<std::size_t>(share * static_cast<float>(slices)), slices - 1);
  }

 private:
  Axis measure(std::size_t d) const {
    float low = at(0, d), high = low;
    double sum = 0, squares = 0;
    for (std::size_t i = 0; i < n_; ++i) {
      const float v = at(i, d);
      low = std::min(low, v);
      high = std::max(high, v);
      sum += v;
    }
    const double mean = sum / static_cast<double>(n_);
    for (std::size_t i = 0; i < n_; ++i) squares += (at(i, d) - mean) * (at(i, d) - mean);
    return {low, high, static_cast<float>(mean),
            static_cast<float>(std::sqrt(squares / static_cast<double>(n_)))};
  }

  const float* p_;
  std::size_t n_;
  float height_;
  std::array<Axis, 3> axis_;
};

void write_size(const Cloud& cloud, float* out) {
  for (std::size_t d = 0; d < 3; ++d) {
    out[d] = log_length(cloud.axis(d).high - cloud.axis(d).low);
    out[3 + d] = log_length(cloud.axis(d).spread);
  }
}

// Moments of the points of one slice.
struct Slice {
  float count = 0, top = std::numeric_limits<float>::lowest();
  std::array<float, 3> first = {}, second = {};

  void add(const std::array<float, 3>& v) {
    count += 1;
    top = std::max(top, v[2]);
    for (std::size_t d = 0; d < 3; ++d) {
      first[d] += v[d];
      second[d] += v[d] * v[d];
    }
  }
  float mean(std::size_t d) const { return count > 0 ? first[d] / count : 0.0f; }
  float spread(std::size_t d) const {
    return count > 0 ? std::sqrt(std::max(second[d] / count - mean(d) * mean(d), 0.0f)) : 0.0f;
  }
};

template <std::size_t Slices>
std::array<Slice, Slices> sliced(const Cloud& cloud, std::size_t d) {
  std::array<Slice, Slices> slices;
  for (std::size_t i = 0; i < cloud.size(); ++i) {
    const std::array<float, 3> v = {cloud.centred(i, 0), cloud.centred(i, 1), cloud.centred(i, 2)};
    slices[cloud.slice(i, d, Slices)].add(v);
  }
  return slices;
}

void write_slices(const Cloud& cloud, float* out) {
  const auto total = static_cast<float>(cloud.size());
  for (const Slice& s : sliced<kLayers>(cloud, 2)) {
    const std::array<float, 7> numbers = {
        s.count / total,        s.mean(0),           s.mean(1),
        std::abs(s.mean(0)),    std::abs(s.mean(1)), log_length(s.spread(0)),
        log_length(s.spread(1))};
    out = std::copy(numbers.begin(), numbers.end(), out);
  }
  for (const Slice& s : sliced<kSections>(cloud, 0)) {
    const std::array<float, 6> numbers = {s.count / total, s.mean(1),   s.mean(2),
                                          s.spread(1),     s.spread(2), s.count > 0 ? s.top : 0.0f};
    out = std::copy(numbers.begin(), numbers.end(), out);
  }
}

constexpr std::size_t kLanes = kSortLanes;
using Row = std::array<float, kLanes>;

// Up to kLanes segments at a time.
class Batch {
 public:
  Batch(const Kernels& kernels, const std::vector<Cloud>& clouds, float* output)
      : kernels_(kernels), clouds_(clouds), output_(output), rows_(kRows) {}

  void write() {
    for (std::size_t lane = 0; lane < clouds_.size(); ++lane) {
      write_size(clouds_[lane], out(lane));
      write_slices(clouds_[lane], out(lane) + kSlices);
    }
    write_quantiles();
    write_distances();
  }

 private:
  static constexpr std::size_t kRows = 512;
  static_assert(kPairs <= kRows && kSorted <= kRows);

  float* out(std::size_t lane) const { return output_ + kSize * lane; }

  // Evenly spaced order statistics of value(cloud, i) for i < count, mapped; `padded` is a power
  // of two.
  template <typename Value, typename Map>
  void marks(std::size_t first, std::size_t number, std::size_t count, std::size_t padded,
             Value&& value, Map&& map) {
    for (Row& row : rows_) row.fill(std::numeric_limits<float>::infinity());
    for (std::size_t lane = 0; lane < clouds_.size(); ++lane) {
      for (std::size_t i = 0; i < count; ++i) rows_[i][lane] = value(clouds_[lane], i);
    }
    kernels_.sort_lanes(rows_.front().data(), padded);
    for (std::size_t lane = 0; lane < clouds_.size(); ++lane) {
      for (std::size_t k = 0; k < number; ++k) {
        const std::size_t rank = (k * (count - 1) + (number - 1) / 2) / (number - 1);
        out(lane)[first + k] = map(clouds_[lane], rows_[rank][lane]);
      }
    }
  }

  void write_quantiles() {
    const auto length = [](const Cloud&, float v) { return log_length(v); };
    const auto square = [](const Cloud&, float v) { return log_length(std::sqrt(v)); };
    const std::size_t count = std::min(clouds_.front().size(), kSorted);
    const auto write = [&](std::size_t k, auto&& value, auto&& map) {
      marks(kQuantiles + k * kMarks, kMarks, count, kSorted, value, map);
    };
    write(
        0, [](const Cloud& c, std::size_t i) { return c.at(i, 2); },
        [](const Cloud& c, float z) { return z + c.height(); });
    write(
        1,
        [](const Cloud& c, std::size_t i) {
          const float x = c.centred(i, 0), y = c.centred(i, 1);
          return x * x + y * y;
        },
        square);
    write(2, [](const Cloud& c, std::size_t i) { return std::abs(c.centred(i, 0)); }, length);
    write(3, [](const Cloud& c, std::size_t i) { return std::abs(c.centred(i, 1)); }, length);
  }

  void write_distances() {
    const auto square = [](const Cloud&, float v) { return log_length(std::sqrt(v)); };
    const auto metres = [](const Cloud&, float v) { return v; };
    const auto between = [](const Cloud& c, std::size_t pair, std::size_t d) {
      return c.at(kPairOf[pair].first, d) - c.at(kPairOf[pair].second, d);
    };
    const auto flat = [&](const Cloud& c, std::size_t i) {
      const float x = between(c, i, 0), y = between(c, i, 1);
      return x * x + y * y;
    };
    const auto space = [&](const Cloud& c, std::size_t i) {
      const float z = between(c, i, 2);
      return flat(c, i) + z * z;
    };
    const auto rise = [&](const Cloud& c, std::size_t i) { return std::abs(between(c, i, 2)); };
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
  const std::vector<Cloud>& clouds_;
  float* output_;
  std::vector<Row> rows_;
};

const std::array<Batch::Pair, kPairs> Batch::kPairOf = Batch::all_pairs();

}  // namespace

std::size_t profile_size() { return kSize; }

void shape_profiles(const float* prepared, const float* heights, std::size_t segments,
                    std::size_t count, int threads, float* output) {
  parallel_for(segments, kLanes, threads, [&](std::size_t begin, std::size_t end, int) {
    std::vector<Cloud> clouds;
    for (std::size_t first = begin; first < end; first += kLanes) {
      clouds.clear();
      for (std::size_t i = first; i < std::min(first + kLanes, end); ++i) {
        clouds.emplace_back(prepared + 3 * count * i, count, heights[i]);
      }
      Batch(best_kernels(), clouds, output + kSize * first).write();
    }
  });
}

}  // namespace segloc
