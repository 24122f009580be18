// ELU and batch norm, forwards and backwards (train_ops.h).
#include <algorithm>
#include <cmath>
#include <numeric>
#include <vector>

#include "common/aligned.h"
#include "common/parallel.h"
#include "training/train_ops.h"

namespace segloc {
namespace {

constexpr std::size_t kFloatsATask = 8192;
constexpr std::size_t kLanes = 16;

// Rows of `columns` values seen as rows of a multiple of 16, as far as they go; the rest, less
// than one such row, is treated by the same kernels with zeros after it.
struct Folded {
  std::size_t width, rows, rest;  // rest: values behind the last whole row
  std::size_t step, chunks;       // rows of a task, and how many tasks there are
  Folded(std::size_t count, std::size_t columns)
      : width(std::lcm(columns, kLanes)),
        rows(count / width),
        rest(count % width),
        step(std::max<std::size_t>(1, kFloatsATask / width)),
        chunks((rows + step - 1) / step) {}
  std::size_t slots() const { return chunks + (rest ? 1 : 0); }
};

// Calls body(first value, rows, slot) for chunks of whole rows; slots are numbered from 0.
template <typename Body>
void for_chunks(const Folded& f, int threads, const Body& body) {
  parallel_for(f.chunks, 1, threads, [&](std::size_t begin, std::size_t end, int) {
    for (std::size_t c = begin; c < end; ++c) {
      body(c * f.step * f.width, std::min(f.step, f.rows - c * f.step), c);
    }
  });
}

// Sums over chunks, and over the columns that a folded row holds several times.
std::vector<double> collected(const std::vector<float>& partial, std::size_t width,
                              std::size_t columns) {
  std::vector<double> result(columns, 0.0);
  for (std::size_t i = 0; i < partial.size(); ++i) result[i % width % columns] += partial[i];
  return result;
}

AlignedFloats repeated(const std::vector<float>& values, std::size_t columns, std::size_t width) {
  const std::size_t kinds = values.size() / columns;
  AlignedFloats result(kinds * width);
  for (std::size_t kind = 0; kind < kinds; ++kind) {
    for (std::size_t i = 0; i < width; ++i) {
      result[kind * width + i] = values[kind * columns + i % columns];
    }
  }
  return result;
}

}  // namespace

void elu_norm_forward(const float* input, std::size_t rows, std::size_t columns, bool activate,
                      const float* weight, const float* bias, float eps, float* z, float* output,
                      float* mean, float* variance, Isa isa, int threads) {
  const TrainKernels& k = kernels(isa).training;
  const Folded f(rows * columns, columns);
  const std::size_t tail = f.rows * f.width, slots = f.slots();
  std::vector<float> sums(slots * f.width, 0.0f), squares(slots * f.width, 0.0f);
  for_chunks(f, threads, [&](std::size_t first, std::size_t count, std::size_t slot) {
    k.elu_sums(input + first, count, f.width, activate, z + first, &sums[slot * f.width],
               &squares[slot * f.width]);
  });
  AlignedFloats rest(f.rest ? 2 * f.width : 0);
  if (f.rest) {
    std::copy_n(input + tail, f.rest, rest.data());
    const std::size_t slot = (slots - 1) * f.width;
    k.elu_sums(rest.data(), 1, f.width, activate, rest.data(), &sums[slot], &squares[slot]);
    std::copy_n(rest.data(), f.rest, z + tail);
  }
  const std::vector<double> sum = collected(sums, f.width, columns);
  const std::vector<double> square = collected(squares, f.width, columns);
  std::vector<float> affine(2 * columns);
  for (std::size_t c = 0; c < columns; ++c) {
    const double m = sum[c] / static_cast<double>(rows);
    const double v = std::max(0.0, square[c] / static_cast<double>(rows) - m * m);
    mean[c] = static_cast<float>(m);
    variance[c] = static_cast<float>(v);
    affine[c] = static_cast<float>(weight[c] / std::sqrt(v + eps));
    affine[columns + c] = static_cast<float>(bias[c] - m * affine[c]);
  }
  const AlignedFloats wide = repeated(affine, columns, f.width);
  for_chunks(f, threads, [&](std::size_t first, std::size_t count, std::size_t) {
    k.scale_shift(z + first, count, f.width, wide.data(), wide.data() + f.width, output + first);
  });
  for (std::size_t i = 0; i < f.rest; ++i) {
    output[tail + i] = z[tail + i] * wide[i] + wide[f.width + i];
  }
}

void elu_norm_backward(const float* gradient, const float* z, std::size_t rows, std::size_t columns,
                       bool activate, const float* weight, float eps, const float* mean,
                       const float* variance, float* grad_input, float* grad_weight,
                       float* grad_bias, Isa isa, int threads) {
  const TrainKernels& k = kernels(isa).training;
  const Folded f(rows * columns, columns);
  const std::size_t tail = f.rows * f.width, slots = f.slots();
  std::vector<float> sums(slots * f.width, 0.0f), products(slots * f.width, 0.0f);
  for_chunks(f, threads, [&](std::size_t first, std::size_t count, std::size_t slot) {
    k.gradient_sums(gradient + first, z + first, count, f.width, &sums[slot * f.width],
                    &products[slot * f.width]);
  });
  for (std::size_t i = 0; i < f.rest; ++i) {
    sums[(slots - 1) * f.width + i] = gradient[tail + i];
    products[(slots - 1) * f.width + i] = gradient[tail + i] * z[tail + i];
  }
  const std::vector<double> sum = collected(sums, f.width, columns);
  const std::vector<double> product = collected(products, f.width, columns);
  std::vector<float> coefficients(3 * columns);
  for (std::size_t c = 0; c < columns; ++c) {
    const double inverse = 1.0 / std::sqrt(static_cast<double>(variance[c]) + eps);
    const double slope = inverse * (product[c] - mean[c] * sum[c]);
    grad_weight[c] = static_cast<float>(slope);
    grad_bias[c] = static_cast<float>(sum[c]);
    const double a = weight[c] * inverse, n = static_cast<double>(rows);
    const double b = -a * inverse * slope / n;
    coefficients[c] = static_cast<float>(a);
    coefficients[columns + c] = static_cast<float>(b);
    coefficients[2 * columns + c] = static_cast<float>(-a * sum[c] / n - b * mean[c]);
  }
  const AlignedFloats wide = repeated(coefficients, columns, f.width);
  for_chunks(f, threads, [&](std::size_t first, std::size_t count, std::size_t) {
    k.norm_gradient(gradient + first, z + first, count, f.width, activate, wide.data(),
                    grad_input + first);
  });
  for (std::size_t i = 0; i < f.rest; ++i) {
    const float y = z[tail + i], g = gradient[tail + i];
    const float d = wide[i] * g + wide[f.width + i] * y + wide[2 * f.width + i];
    grad_input[tail + i] = activate ? d * std::min(y + 1.0f, 1.0f) : d;
  }
}

}  // namespace segloc
