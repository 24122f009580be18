// The inner loops of train_ops.h. Channels lie in lanes; rows and channels are padded with zeros,
// so that no loop has a remainder.
#pragma once

#include "simd/kernels.h"
#include "simd/simd.h"

namespace segloc {
namespace SEGLOC_ISA {
namespace {

constexpr size_t kRowBlock = 4;

// out (rows, width) = a (rows, inner) b (inner, width); rows a multiple of 4, width of the vectors.
inline void small_product(const float* a, size_t a_stride, const float* b, size_t rows,
                          size_t inner, size_t width, float* out) {
  for (size_t v = 0; v < width; v += kWidth) {
    for (size_t first = 0; first < rows; first += kRowBlock) {
      Vec sum[kRowBlock];
      SEGLOC_UNROLL
      for (size_t r = 0; r < kRowBlock; ++r) sum[r] = broadcast(0.0f);
      const float* left = a + first * a_stride;
      for (size_t i = 0; i < inner; ++i) {
        const Vec right = load(b + i * width + v);
        SEGLOC_UNROLL
        for (size_t r = 0; r < kRowBlock; ++r) {
          sum[r] = fma(broadcast(left[r * a_stride + i]), right, sum[r]);
        }
      }
      SEGLOC_UNROLL
      for (size_t r = 0; r < kRowBlock; ++r) store(out + (first + r) * width + v, sum[r]);
    }
  }
}

inline void apply_point(const ApplyPoint& p) {
  small_product(p.x, p.rows, p.f, p.rows, p.neighbors, p.width, p.t);
  for (size_t m = 0; m < p.depth; ++m) {
    const float* d = p.depthwise + m * p.rows * p.width;
    for (size_t v = 0; v < p.width; v += kWidth) {
      Vec sum = broadcast(0.0f);
      for (size_t k = 0; k < p.neighbors; ++k) {
        sum = fma(load(p.t + k * p.width + v), load(d + k * p.width + v), sum);
      }
      store(p.output + m * p.width + v, sum);
    }
  }
}

inline void apply_point_backward(const ApplyPoint& p) {
  small_product(p.x, p.rows, p.f, p.rows, p.neighbors, p.width, p.t);
  for (size_t v = 0; v < p.width; v += kWidth) {
    for (size_t k = 0; k < p.neighbors; ++k) {
      const Vec t = load(p.t + k * p.width + v);
      Vec sum = broadcast(0.0f);
      for (size_t m = 0; m < p.depth; ++m) {
        const size_t at = (m * p.rows + k) * p.width + v;
        const Vec g = load(p.output + m * p.width + v);
        sum = fma(g, load(p.depthwise + at), sum);
        store(p.grad_depthwise + at, fma(g, t, load(p.grad_depthwise + at)));
      }
      store(p.grad_t + k * p.width + v, sum);
    }
  }
  small_product(p.x_transposed, p.rows, p.grad_t, p.rows, p.neighbors, p.width, p.grad_f);
  small_product(p.grad_t, p.width, p.f_transposed, p.rows, p.width, p.lanes, p.grad_x);
}

// For Points points and column c: sum over i of x[i * step] times row i of the weight.
template <size_t Points>
inline void column_rows(const float* x, size_t step, size_t stride, const float* weight,
                        size_t inner, size_t lanes, float* y, size_t y_stride) {
  for (size_t v = 0; v < lanes; v += kWidth) {
    Vec sum[Points];
    SEGLOC_UNROLL
    for (size_t p = 0; p < Points; ++p) sum[p] = broadcast(0.0f);
    for (size_t i = 0; i < inner; ++i) {
      const Vec w = load(weight + i * lanes + v);
      SEGLOC_UNROLL
      for (size_t p = 0; p < Points; ++p) {
        sum[p] = fma(broadcast(x[p * stride + i * step]), w, sum[p]);
      }
    }
    SEGLOC_UNROLL
    for (size_t p = 0; p < Points; ++p) store(y + p * y_stride + v, sum[p]);
  }
}

// Rows overlap where K is no multiple of the vectors: each is written after the one before it.
inline void columns(const ColumnTask& t) {
  const size_t K = t.neighbors, square = K * K;
  for (size_t p = 0; p < t.points; ++p) {
    for (size_t c = 0; c < K; ++c) {
      column_rows<1>(t.x + p * square + c, K, square, t.weight + c * K * t.lanes, K, t.lanes,
                     t.y + p * square + c * K, square);
    }
  }
}

inline void columns_backward(const ColumnTask& t) {
  constexpr size_t kBlockRows = 4;
  const size_t K = t.neighbors, square = K * K;
  for (size_t p = 0; p < t.points; ++p) {
    for (size_t c = 0; c < K; ++c) {
      column_rows<1>(t.y + p * square + c * K, 1, square, t.transposed + c * K * t.lanes, K,
                     t.lanes, t.scratch + c * t.lanes, 0);
    }
    for (size_t i = 0; i < K; ++i) {
      for (size_t c = 0; c < K; ++c) t.grad_x[p * square + i * K + c] = t.scratch[c * t.lanes + i];
    }
  }
  for (size_t c = 0; c < K; ++c) {
    for (size_t v = 0; v < t.lanes; v += kWidth) {
      for (size_t first = 0; first < K; first += kBlockRows) {
        const size_t rows = K - first < kBlockRows ? K - first : kBlockRows;
        float* out = t.grad_weight + (c * K + first) * t.lanes + v;
        const float* x = t.x + first * K + c;
        const float* y = t.y + c * K + v;
        Vec sum[kBlockRows];
        SEGLOC_UNROLL
        for (size_t r = 0; r < kBlockRows; ++r) sum[r] = broadcast(0.0f);
        if (rows == kBlockRows) {
          for (size_t p = 0; p < t.points; ++p) {
            const Vec g = load(y + p * square);
            SEGLOC_UNROLL
            for (size_t r = 0; r < kBlockRows; ++r) {
              sum[r] = fma(broadcast(x[p * square + r * K]), g, sum[r]);
            }
          }
        } else {
          for (size_t p = 0; p < t.points; ++p) {
            const Vec g = load(y + p * square);
            for (size_t r = 0; r < rows; ++r) {
              sum[r] = fma(broadcast(x[p * square + r * K]), g, sum[r]);
            }
          }
        }
        for (size_t r = 0; r < rows; ++r)
          store(out + r * t.lanes, load(out + r * t.lanes) + sum[r]);
      }
    }
  }
}

inline void elu_sums(const float* input, size_t rows, size_t width, bool activate, float* z,
                     float* sum, float* square) {
  for (size_t v = 0; v < width; v += kWidth) {
    Vec s = broadcast(0.0f), q = s;
    for (size_t r = 0; r < rows; ++r) {
      const size_t at = r * width + v;
      Vec x = load(input + at);
      if (activate) x = elu(x);
      store(z + at, x);
      s = s + x;
      q = fma(x, x, q);
    }
    store(sum + v, s);
    store(square + v, q);
  }
}

inline void scale_shift(const float* z, size_t rows, size_t width, const float* scale,
                        const float* shift, float* output) {
  for (size_t v = 0; v < width; v += kWidth) {
    const Vec a = load(scale + v), b = load(shift + v);
    for (size_t r = 0; r < rows; ++r) {
      store(output + r * width + v, fma(load(z + r * width + v), a, b));
    }
  }
}

inline void gradient_sums(const float* gradient, const float* z, size_t rows, size_t width,
                          float* sum, float* product) {
  for (size_t v = 0; v < width; v += kWidth) {
    Vec s = broadcast(0.0f), q = s;
    for (size_t r = 0; r < rows; ++r) {
      const Vec g = load(gradient + r * width + v);
      s = s + g;
      q = fma(g, load(z + r * width + v), q);
    }
    store(sum + v, s);
    store(product + v, q);
  }
}

// (a g + b z + c) times the slope of the ELU, which is z + 1 below zero.
inline void norm_gradient(const float* gradient, const float* z, size_t rows, size_t width,
                          bool activate, const float* coefficients, float* output) {
  const Vec one = broadcast(1.0f);
  for (size_t v = 0; v < width; v += kWidth) {
    const Vec a = load(coefficients + v), b = load(coefficients + width + v);
    const Vec c = load(coefficients + 2 * width + v);
    for (size_t r = 0; r < rows; ++r) {
      const size_t at = r * width + v;
      const Vec y = load(z + at);
      const Vec d = fma(a, load(gradient + at), fma(b, y, c));
      store(output + at, activate ? d * min(y + one, one) : d);
    }
  }
}

constexpr TrainKernels kTraining = {
    &apply_point, &apply_point_backward, &columns,       &columns_backward,
    &elu_sums,    &scale_shift,          &gradient_sums, &norm_gradient};

}  // namespace
}  // namespace SEGLOC_ISA
}  // namespace segloc
