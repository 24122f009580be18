#include "proposals/matching/descriptor_boxes.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <utility>

#include "common/parallel.h"

namespace segloc {
namespace {

constexpr std::size_t kFewestRows = 4096;  // in fewer rows boxes cost more than they spare
constexpr std::size_t kSampled = 1024;     // rows that the axes are found by
constexpr int kRounds = 6;                 // of the subspace iteration
constexpr std::size_t kSpreadRows = 256;   // rows that an axis to split along is chosen by

double dot(const double* a, const double* b, std::size_t n) {
  double sum = 0.0;
  for (std::size_t i = 0; i < n; ++i) sum += a[i] * b[i];
  return sum;
}

// Rows become orthonormal; one that depends on those before it becomes zero.
void orthonormalize(std::vector<double>& rows, std::size_t dim) {
  constexpr double kTiny = 1e-9;
  for (std::size_t k = 0; k < kBoxAxes; ++k) {
    double* row = rows.data() + k * dim;
    const double before = std::sqrt(dot(row, row, dim));
    for (int pass = 0; pass < 2; ++pass) {
      for (std::size_t j = 0; j < k; ++j) {
        const double* other = rows.data() + j * dim;
        const double along = dot(row, other, dim);
        for (std::size_t d = 0; d < dim; ++d) row[d] -= along * other[d];
      }
    }
    const double length = std::sqrt(dot(row, row, dim));
    const double scale = length > kTiny * before && length > 0.0 ? 1.0 / length : 0.0;
    for (std::size_t d = 0; d < dim; ++d) row[d] *= scale;
  }
}

// Evenly spaced rows less their mean, divided by their largest magnitude.
std::vector<double> centred_sample(const DescriptorRows& database, std::size_t sampled) {
  const std::size_t dim = database.dim;
  std::vector<double> sample(sampled * dim), mean(dim, 0.0);
  std::vector<float> buffer;
  for (std::size_t i = 0; i < sampled; ++i) {
    const float* row = database.read(i * database.count / sampled, 1, buffer);
    for (std::size_t d = 0; d < dim; ++d) {
      sample[i * dim + d] = row[d];
      mean[d] += row[d] / static_cast<double>(sampled);
    }
  }
  double largest = 0.0;
  for (std::size_t i = 0; i < sample.size(); ++i) {
    sample[i] -= mean[i % dim];
    largest = std::max(largest, std::fabs(sample[i]));
  }
  for (double& value : sample) value /= std::max(largest, 1e-30);
  return sample;
}

// Whether a splits before b: by coordinate, and then by row.
using Keyed = std::pair<float, std::uint32_t>;

std::size_t widest_axis(const float* projections, const std::uint32_t* begin, std::size_t n) {
  const std::size_t step = std::max<std::size_t>(1, n / kSpreadRows);
  double best = -1.0;
  std::size_t axis = 0;
  for (std::size_t a = 0; a < kBoxAxes; ++a) {
    double sum = 0.0, squares = 0.0, rows = 0.0;
    for (std::size_t i = 0; i < n; i += step) {
      const double x = projections[begin[i] * kBoxAxes + a];
      sum += x, squares += x * x, rows += 1.0;
    }
    const double spread = squares - sum * sum / rows;
    if (spread > best) best = spread, axis = a;
  }
  return axis;
}

void split(const float* projections, std::size_t block, std::uint32_t* begin, std::uint32_t* end,
           std::vector<Keyed>& keyed) {
  const auto n = static_cast<std::size_t>(end - begin);
  if (n <= block) return;
  const std::size_t axis = widest_axis(projections, begin, n), half = padded(n / 2, block);
  keyed.resize(n);
  for (std::size_t i = 0; i < n; ++i) {
    keyed[i] = {projections[begin[i] * kBoxAxes + axis], begin[i]};
  }
  std::nth_element(keyed.begin(), keyed.begin() + static_cast<std::ptrdiff_t>(half), keyed.end());
  for (std::size_t i = 0; i < n; ++i) begin[i] = keyed[i].second;
  split(projections, block, begin, begin + half, keyed);
  split(projections, block, begin + half, end, keyed);
}

}  // namespace

// Subspace iteration: axes <- sample^T (sample axes), made orthonormal.
DescriptorAxes::DescriptorAxes(const DescriptorRows& database) : dim_(database.dim) {
  if (database.count < kFewestRows) return;
  const std::size_t dim = dim_, sampled = std::min(database.count, kSampled);
  const std::vector<double> sample = centred_sample(database, sampled);
  // It sets out from rows of the sample, far from each other.
  std::vector<double> axes(kBoxAxes * dim), next(kBoxAxes * dim);
  for (std::size_t k = 0; k < kBoxAxes; ++k) {
    std::copy_n(sample.data() + k * sampled / kBoxAxes * dim, dim, axes.data() + k * dim);
  }
  for (int round = 0; round < kRounds; ++round) {
    orthonormalize(axes, dim);
    std::fill(next.begin(), next.end(), 0.0);
    for (std::size_t i = 0; i < sampled; ++i) {
      const double* row = sample.data() + i * dim;
      for (std::size_t k = 0; k < kBoxAxes; ++k) {
        const double along = dot(row, axes.data() + k * dim, dim);
        for (std::size_t d = 0; d < dim; ++d) next[k * dim + d] += along * row[d];
      }
    }
    axes.swap(next);
  }
  orthonormalize(axes, dim);
  axes_.assign(axes.begin(), axes.end());
}

float DescriptorAxes::project(const float* rows, std::size_t n, int threads,
                              float* projections) const {
  constexpr std::size_t kRows = 1024;
  std::vector<float> largest((n + kRows - 1) / kRows, 0.0f);
  parallel_for(n, kRows, threads, [&](std::size_t begin, std::size_t end, int) {
    for (std::size_t i = begin; i < end; ++i) {
      for (std::size_t k = 0; k < kBoxAxes; ++k) {
        const float* axis = axes_.data() + k * dim_;
        double sums[4] = {0.0, 0.0, 0.0, 0.0};
        for (std::size_t d = 0; d < dim_; ++d) {
          sums[d % 4] += double{axis[d]} * double{rows[i * dim_ + d]};
        }
        const auto value = static_cast<float>((sums[0] + sums[1]) + (sums[2] + sums[3]));
        projections[i * kBoxAxes + k] = value;
        largest[begin / kRows] = std::max(largest[begin / kRows], std::fabs(value));
      }
    }
  });
  return n == 0 ? 0.0f : *std::max_element(largest.begin(), largest.end());
}

void order_by_place(const float* projections, std::size_t block, std::uint32_t* begin,
                    std::uint32_t* end) {
  std::vector<Keyed> keyed;
  split(projections, block, begin, end, keyed);
}

void DescriptorBoxes::resize(std::size_t groups) {
  values_ = AlignedFloats(groups * kGroupFloats);
  for (std::size_t i = 0; i < groups * kGroupFloats; ++i) {
    const bool lower = i / kBoxRun % 2 == 0;
    values_.data()[i] = std::numeric_limits<float>::infinity() * (lower ? 1.0f : -1.0f);
  }
}

void DescriptorBoxes::add(std::size_t group, std::size_t block, const float* projection) {
  float* values = values_.data() + group * kGroupFloats + block;
  for (std::size_t a = 0; a < kBoxAxes; ++a) {
    float &low = values[2 * a * kBoxRun], &high = values[(2 * a + 1) * kBoxRun];
    low = std::min(low, projection[a]);
    high = std::max(high, projection[a]);
  }
}

}  // namespace segloc
