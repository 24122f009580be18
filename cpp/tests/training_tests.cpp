// The operations of training, at sizes that are no multiples of the vectors.
#include <cmath>
#include <cstdint>
#include <vector>

#include "tests/check.h"
#include "training/train_ops.h"

namespace segloc {
namespace {

using Floats = std::vector<float>;

void applied(Isa isa, std::size_t K, std::size_t lifted, std::size_t inputs) {
  const ApplyShape s = {5, 3, 9, K, lifted, inputs, 2};
  const std::size_t rows = s.clouds * s.points * K, C = s.channels();
  const Floats x = random_floats(rows * K, -1, 1, 1), lift = random_floats(rows * lifted, -1, 1, 2);
  const Floats features = random_floats(s.clouds * s.sources * inputs, -1, 1, 3);
  const Floats depthwise = random_floats(s.depth * K * C, -1, 1, 4);
  std::vector<int64_t> neighbors(rows);
  for (std::size_t i = 0; i < rows; ++i) neighbors[i] = static_cast<int64_t>(i * 7 % s.sources);
  const ApplyInputs in = {x.data(), lift.data(), features.data(), neighbors.data(),
                          depthwise.data()};
  const std::size_t size = s.clouds * s.points * s.depth * C;
  Floats output(size, NAN), again(size, NAN);
  apply_forward(s, in, output.data(), isa, 1);
  apply_forward(s, in, again.data(), isa, 3);
  CHECK(output == again && all_finite(output));
  Floats gradients[2];
  for (const int threads : {1, 3}) {
    Floats gx(x.size(), NAN), gl(lift.size(), NAN), gf(features.size(), 0.0f);
    Floats gd(depthwise.size(), NAN);
    apply_backward(s, in, output.data(), {gx.data(), gl.data(), gf.data(), gd.data()}, isa,
                   threads);
    Floats& all = gradients[threads / 3];
    for (const Floats* part : {&gx, &gl, &gf, &gd})
      all.insert(all.end(), part->begin(), part->end());
  }
  CHECK(gradients[0] == gradients[1] && all_finite(gradients[0]));
  digest(isa, "apply", output);
  digest(isa, "apply_backward", gradients[0]);
}

void column_maps(Isa isa, std::size_t K, std::size_t count) {
  const Floats x = random_floats(count * K * K, -1, 1, 5);
  const Floats weight = random_floats(K * K * K, -1, 1, 6);
  Floats output(x.size(), NAN), grad_x(x.size(), NAN), grad_weight(weight.size(), NAN);
  columns_forward(x.data(), weight.data(), count, K, output.data(), isa, 2);
  for (std::size_t at = 0; at < output.size(); ++at) {
    const std::size_t o = at % K, c = at / K % K, first = at / (K * K) * K * K;
    double sum = 0;
    for (std::size_t i = 0; i < K; ++i) sum += x[first + i * K + c] * weight[(i * K + c) * K + o];
    CHECK(std::abs(output[at] - sum) < 1e-4);
  }
  columns_backward(x.data(), weight.data(), output.data(), count, K, grad_x.data(),
                   grad_weight.data(), isa, 2);
  CHECK(all_finite(grad_x) && all_finite(grad_weight));
  digest(isa, "columns", output);
  digest(isa, "columns", grad_weight);
}

void norm(Isa isa, std::size_t rows, std::size_t columns, bool activate) {
  const Floats input = random_floats(rows * columns, -3, 3, 7);
  const Floats weight = random_floats(columns, -1, 1, 8), bias = random_floats(columns, -1, 1, 9);
  Floats z(input.size(), NAN), output(input.size(), NAN), gradient(input.size(), NAN);
  Floats mean(columns, NAN), variance(columns, NAN), grad_weight(columns, NAN),
      grad_bias(columns, NAN);
  elu_norm_forward(input.data(), rows, columns, activate, weight.data(), bias.data(), 1e-3f,
                   z.data(), output.data(), mean.data(), variance.data(), isa, 2);
  elu_norm_backward(output.data(), z.data(), rows, columns, activate, weight.data(), 1e-3f,
                    mean.data(), variance.data(), gradient.data(), grad_weight.data(),
                    grad_bias.data(), isa, 2);
  for (const Floats* each : {&output, &mean, &variance, &gradient, &grad_weight, &grad_bias}) {
    CHECK(all_finite(*each));
    digest(isa, "elu_norm", *each);
  }
}

}  // namespace
}  // namespace segloc

void training_tests() {
  for (const segloc::Isa isa : instruction_sets()) {
    for (const std::size_t K : {1, 5, 8, 12, 16, 17}) {
      segloc::applied(isa, K, 6, 0);
      segloc::applied(isa, K, 3, 18);
      for (const std::size_t count : {1, 64, 130}) segloc::column_maps(isa, K, count);
    }
    for (const std::size_t rows : {1, 7, 1000}) {
      for (const std::size_t columns : {1, 16, 37, 64}) {
        segloc::norm(isa, rows, columns, true);
        segloc::norm(isa, rows, columns, false);
      }
    }
  }
}
