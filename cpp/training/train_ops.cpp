#include "training/train_ops.h"

#include <algorithm>

#include "common/aligned.h"
#include "common/parallel.h"

namespace segloc {
namespace {

constexpr std::size_t kCloudsATask = 4;
constexpr std::size_t kMatricesATask = 64;
constexpr std::size_t kLanes = 16;

// Scratch memory of one worker, and how inputs are brought into it.
class PointScratch {
 public:
  PointScratch(const ApplyShape& shape, const AlignedFloats& depthwise)
      : shape_(shape), K_(shape.neighbors) {
    p_.neighbors = K_;
    p_.rows = padded(K_, 4);
    p_.width = padded(shape.channels(), kLanes);
    p_.lanes = padded(K_, kLanes);
    p_.depth = shape.depth;
    const std::size_t square = p_.rows * p_.rows, wide = p_.rows * p_.width;
    memory_ = AlignedFloats(2 * padded(square, kLanes) + 4 * wide + p_.width * p_.lanes +
                            p_.depth * p_.width + p_.rows * p_.lanes);
    float* next = memory_.data();
    const auto take = [&next](std::size_t size) {
      float* taken = next;
      next += size;
      return taken;
    };
    p_.x = x_ = take(padded(square, kLanes));
    p_.x_transposed = xt_ = take(padded(square, kLanes));
    p_.f = f_ = take(wide);
    p_.t = take(wide);
    p_.grad_t = take(wide);
    p_.grad_f = take(wide);
    p_.f_transposed = ft_ = take(p_.width * p_.lanes);
    p_.output = take(p_.depth * p_.width);
    p_.grad_x = take(p_.rows * p_.lanes);
    p_.depthwise = depthwise.data();
    p_.grad_depthwise = nullptr;
  }

  ApplyPoint& point() { return p_; }

  void load(const ApplyInputs& in, std::size_t cloud, std::size_t point) {
    const std::size_t at = cloud * shape_.points + point;
    const float* x = in.x + at * K_ * K_;
    for (std::size_t k = 0; k < K_; ++k) std::copy_n(x + k * K_, K_, x_ + k * p_.rows);
    for (std::size_t j = 0; j < K_; ++j) {
      float* row = f_ + j * p_.width;
      std::copy_n(in.lift + (at * K_ + j) * shape_.lifted, shape_.lifted, row);
      if (shape_.inputs > 0) {
        const auto source = static_cast<std::size_t>(in.neighbors[at * K_ + j]);
        std::copy_n(in.features + (cloud * shape_.sources + source) * shape_.inputs, shape_.inputs,
                    row + shape_.lifted);
      }
    }
  }

  void transpose() {
    for (std::size_t k = 0; k < K_; ++k) {
      for (std::size_t j = 0; j < K_; ++j) xt_[j * p_.rows + k] = x_[k * p_.rows + j];
    }
    for (std::size_t j = 0; j < K_; ++j) {
      for (std::size_t c = 0; c < p_.width; ++c) ft_[c * p_.lanes + j] = f_[j * p_.width + c];
    }
  }

 private:
  const ApplyShape& shape_;
  std::size_t K_;
  AlignedFloats memory_;
  ApplyPoint p_;
  float *x_, *xt_, *f_, *ft_;
};

// (depth, K, channels) -> (depth, rows, width), with zeros.
AlignedFloats padded_depthwise(const ApplyShape& shape, const float* depthwise) {
  const std::size_t rows = padded(shape.neighbors, 4), width = padded(shape.channels(), kLanes);
  AlignedFloats result(shape.depth * rows * width);
  for (std::size_t m = 0; m < shape.depth; ++m) {
    for (std::size_t k = 0; k < shape.neighbors; ++k) {
      std::copy_n(depthwise + (m * shape.neighbors + k) * shape.channels(), shape.channels(),
                  result.data() + (m * rows + k) * width);
    }
  }
  return result;
}

void store_gradients(const ApplyShape& shape, const ApplyInputs& in, const ApplyPoint& p,
                     std::size_t cloud, std::size_t point, const ApplyGradients& out) {
  const std::size_t K = shape.neighbors, at = cloud * shape.points + point;
  for (std::size_t k = 0; k < K; ++k) {
    std::copy_n(p.grad_x + k * p.lanes, K, out.x + (at * K + k) * K);
  }
  for (std::size_t j = 0; j < K; ++j) {
    const float* row = p.grad_f + j * p.width;
    std::copy_n(row, shape.lifted, out.lift + (at * K + j) * shape.lifted);
    if (shape.inputs == 0) continue;
    const auto source = static_cast<std::size_t>(in.neighbors[at * K + j]);
    float* sum = out.features + (cloud * shape.sources + source) * shape.inputs;
    for (std::size_t c = 0; c < shape.inputs; ++c) sum[c] += row[shape.lifted + c];
  }
}

// weight (K, K, K): [i][c][o] -> [c][i][lane o], or [c][o][lane i].
AlignedFloats column_weights(const float* weight, std::size_t K, bool transposed) {
  const std::size_t lanes = padded(K, kLanes);
  AlignedFloats result(K * K * lanes);
  for (std::size_t i = 0; i < K; ++i) {
    for (std::size_t c = 0; c < K; ++c) {
      for (std::size_t o = 0; o < K; ++o) {
        result[(c * K + (transposed ? o : i)) * lanes + (transposed ? i : o)] =
            weight[(i * K + c) * K + o];
      }
    }
  }
  return result;
}

}  // namespace

void apply_forward(const ApplyShape& shape, const ApplyInputs& in, float* output, Isa isa,
                   int threads) {
  const TrainKernels& k = kernels(isa).training;
  const AlignedFloats depthwise = padded_depthwise(shape, in.depthwise);
  const std::size_t C = shape.channels();
  parallel_for(shape.clouds, kCloudsATask, threads, [&](std::size_t begin, std::size_t end, int) {
    PointScratch scratch(shape, depthwise);
    const ApplyPoint& p = scratch.point();
    for (std::size_t cloud = begin; cloud < end; ++cloud) {
      for (std::size_t n = 0; n < shape.points; ++n) {
        scratch.load(in, cloud, n);
        k.apply(p);
        float* to = output + (cloud * shape.points + n) * shape.depth * C;
        for (std::size_t m = 0; m < shape.depth; ++m)
          std::copy_n(p.output + m * p.width, C, to + m * C);
      }
    }
  });
}

void apply_backward(const ApplyShape& shape, const ApplyInputs& in, const float* gradient,
                    const ApplyGradients& out, Isa isa, int threads) {
  const TrainKernels& k = kernels(isa).training;
  const AlignedFloats depthwise = padded_depthwise(shape, in.depthwise);
  const std::size_t C = shape.channels(), size = depthwise.size();
  const std::size_t tasks = (shape.clouds + kCloudsATask - 1) / kCloudsATask;
  AlignedFloats partial(tasks * size);
  parallel_for(tasks, 1, threads, [&](std::size_t begin, std::size_t end, int) {
    PointScratch scratch(shape, depthwise);
    ApplyPoint& p = scratch.point();
    for (std::size_t task = begin; task < end; ++task) {
      p.grad_depthwise = partial.data() + task * size;
      const std::size_t last = std::min(shape.clouds, (task + 1) * kCloudsATask);
      for (std::size_t cloud = task * kCloudsATask; cloud < last; ++cloud) {
        for (std::size_t n = 0; n < shape.points; ++n) {
          scratch.load(in, cloud, n);
          scratch.transpose();
          const float* from = gradient + (cloud * shape.points + n) * shape.depth * C;
          for (std::size_t m = 0; m < shape.depth; ++m) {
            std::copy_n(from + m * C, C, p.output + m * p.width);
          }
          k.apply_backward(p);
          store_gradients(shape, in, p, cloud, n, out);
        }
      }
    }
  });
  const std::size_t rows = padded(shape.neighbors, 4), width = padded(C, kLanes);
  std::fill_n(out.depthwise, shape.depth * shape.neighbors * C, 0.0f);
  for (std::size_t task = 0; task < tasks; ++task) {
    for (std::size_t m = 0; m < shape.depth; ++m) {
      for (std::size_t n = 0; n < shape.neighbors; ++n) {
        const float* from = partial.data() + task * size + (m * rows + n) * width;
        float* to = out.depthwise + (m * shape.neighbors + n) * C;
        for (std::size_t c = 0; c < C; ++c) to[c] += from[c];
      }
    }
  }
}

void columns_forward(const float* x, const float* weight, std::size_t count, std::size_t K,
                     float* output, Isa isa, int threads) {
  const TrainKernels& k = kernels(isa).training;
  const AlignedFloats wide = column_weights(weight, K, false);
  const std::size_t lanes = padded(K, kLanes), square = K * K;
  parallel_for(count, kMatricesATask, threads, [&](std::size_t begin, std::size_t end, int) {
    AlignedFloats y(kMatricesATask * square + kLanes);
    for (std::size_t first = begin; first < end; first += kMatricesATask) {
      const std::size_t points = std::min(kMatricesATask, end - first);
      k.columns({points, K, lanes, x + first * square, wide.data(), nullptr, y.data(), nullptr,
                 nullptr, nullptr});
      std::copy_n(y.data(), points * square, output + first * square);
    }
  });
}

void columns_backward(const float* x, const float* weight, const float* gradient, std::size_t count,
                      std::size_t K, float* grad_x, float* grad_weight, Isa isa, int threads) {
  const TrainKernels& k = kernels(isa).training;
  const AlignedFloats transposed = column_weights(weight, K, true);
  const std::size_t lanes = padded(K, kLanes), square = K * K, size = square * lanes;
  const std::size_t tasks = (count + kMatricesATask - 1) / kMatricesATask;
  AlignedFloats partial(tasks * size);
  parallel_for(tasks, 1, threads, [&](std::size_t begin, std::size_t end, int) {
    AlignedFloats y(kMatricesATask * square + kLanes), scratch(K * lanes);
    for (std::size_t task = begin; task < end; ++task) {
      const std::size_t first = task * kMatricesATask;
      const std::size_t points = std::min(kMatricesATask, count - first);
      std::copy_n(gradient + first * square, points * square, y.data());
      k.columns_backward({points, K, lanes, x + first * square, nullptr, transposed.data(),
                          y.data(), grad_x + first * square, partial.data() + task * size,
                          scratch.data()});
    }
  });
  std::fill_n(grad_weight, square * K, 0.0f);
  for (std::size_t task = 0; task < tasks; ++task) {
    for (std::size_t c = 0; c < K; ++c) {
      for (std::size_t i = 0; i < K; ++i) {
        const float* from = partial.data() + task * size + (c * K + i) * lanes;
        float* to = grad_weight + (i * K + c) * K;
        for (std::size_t o = 0; o < K; ++o) to[o] += from[o];
      }
    }
  }
}

}  // namespace segloc
