// The operations of training.
#include <algorithm>
#include <iterator>

#include "bindings/bindings.h"
#include "training/train_ops.h"

namespace segloc::bindings {
namespace {

// Arrays that the caller made and these functions fill.
using Result = nb::ndarray<float, nb::c_contig, nb::device::cpu>;
template <typename Array>
void require_size(const Array& array, std::size_t size, const char* name) {
  require(array.size() == size, std::string(name) + " has the wrong size");
}

// Limit of sizes that are multiplied before memory is allocated.
constexpr std::size_t kMostOnAxis = 65536, kMostNeighbors = 256;

struct Apply {
  ApplyShape shape;
  ApplyInputs in;

  Apply(In<float, nb::ndim<4>> x, In<float, nb::ndim<4>> lift, In3<float> features,
        In3<int64_t> neighbors, In3<float> depthwise)
      : shape{neighbors.shape(0), neighbors.shape(1), features.shape(1), neighbors.shape(2),
              lift.shape(3),      features.shape(2),  depthwise.shape(0)},
        in{x.data(), lift.data(), features.data(), neighbors.data(), depthwise.data()} {
    const std::size_t rows = neighbors.size();
    const std::size_t axes[] = {shape.points, shape.sources, shape.neighbors,
                                shape.lifted, shape.inputs,  shape.depth};
    require(*std::max_element(std::begin(axes), std::end(axes)) <= kMostOnAxis,
            "an axis is too long");
    require(shape.neighbors <= kMostNeighbors, "there are too many neighbors");
    require(features.shape(0) == shape.clouds, "features and neighbors differ in clouds");
    require(shape.neighbors > 0 && shape.depth > 0 && shape.lifted > 0, "an axis is empty");
    require_size(x, rows * shape.neighbors, "x");
    require_size(lift, rows * shape.lifted, "lift");
    require_size(depthwise, shape.depth * shape.neighbors * shape.channels(), "depthwise");
    if (shape.inputs == 0) return;
    for (std::size_t i = 0; i < rows; ++i) {
      const int64_t source = neighbors.data()[i];
      require(source >= 0 && source < static_cast<int64_t>(shape.sources),
              "neighbors name a source that does not exist");
    }
  }
};

void forward(In<float, nb::ndim<4>> x, In<float, nb::ndim<4>> lift, In3<float> features,
             In3<int64_t> neighbors, In3<float> depthwise, Result output, int threads,
             const std::string& isa) {
  const Apply apply(x, lift, features, neighbors, depthwise);
  const ApplyShape& s = apply.shape;
  require_size(output, s.clouds * s.points * s.depth * s.channels(), "output");
  const Isa chosen = parse_isa(isa);
  nb::gil_scoped_release release;
  apply_forward(s, apply.in, output.data(), chosen, threads);
}

void backward(In<float, nb::ndim<4>> x, In<float, nb::ndim<4>> lift, In3<float> features,
              In3<int64_t> neighbors, In3<float> depthwise, In<float> gradient, Result grad_x,
              Result grad_lift, Result grad_features, Result grad_depthwise, int threads,
              const std::string& isa) {
  const Apply apply(x, lift, features, neighbors, depthwise);
  const ApplyShape& s = apply.shape;
  require_size(gradient, s.clouds * s.points * s.depth * s.channels(), "gradient");
  require_size(grad_x, x.size(), "grad_x");
  require_size(grad_lift, lift.size(), "grad_lift");
  require_size(grad_features, features.size(), "grad_features");
  require_size(grad_depthwise, depthwise.size(), "grad_depthwise");
  const Isa chosen = parse_isa(isa);
  nb::gil_scoped_release release;
  std::fill_n(grad_features.data(), grad_features.size(), 0.0f);
  apply_backward(s, apply.in, gradient.data(),
                 {grad_x.data(), grad_lift.data(), grad_features.data(), grad_depthwise.data()},
                 chosen, threads);
}

std::size_t checked_columns(In3<float> x, In3<float> weight) {
  const std::size_t K = x.shape(2);
  require(K > 0 && x.shape(1) == K, "x must have shape (R, K, K)");
  require(K <= kMostNeighbors, "there are too many neighbors");
  require(weight.shape(0) == K && weight.shape(1) == K && weight.shape(2) == K,
          "weight must have shape (K, K, K)");
  return K;
}

void column_maps(In3<float> x, In3<float> weight, Result output, int threads,
                 const std::string& isa) {
  const std::size_t K = checked_columns(x, weight);
  require_size(output, x.size(), "output");
  const Isa chosen = parse_isa(isa);
  nb::gil_scoped_release release;
  columns_forward(x.data(), weight.data(), x.shape(0), K, output.data(), chosen, threads);
}

void column_maps_backward(In3<float> x, In3<float> weight, In3<float> gradient, Result grad_x,
                          Result grad_weight, int threads, const std::string& isa) {
  const std::size_t K = checked_columns(x, weight);
  require_size(gradient, x.size(), "gradient");
  require_size(grad_x, x.size(), "grad_x");
  require_size(grad_weight, weight.size(), "grad_weight");
  const Isa chosen = parse_isa(isa);
  nb::gil_scoped_release release;
  columns_backward(x.data(), weight.data(), gradient.data(), x.shape(0), K, grad_x.data(),
                   grad_weight.data(), chosen, threads);
}

void norm_forward(In2<float> input, bool activate, In1<float> weight, In1<float> bias, float eps,
                  Result z, Result output, Result mean, Result variance, int threads,
                  const std::string& isa) {
  const std::size_t rows = input.shape(0), columns = input.shape(1);
  require(rows > 0 && columns > 0, "input is empty");
  require_columns(columns, "input");
  require_between(eps, 1e-30, 1e15, "eps");
  require_size(weight, columns, "weight");
  require_size(bias, columns, "bias");
  require_size(z, input.size(), "z");
  require_size(output, input.size(), "output");
  require_size(mean, columns, "mean");
  require_size(variance, columns, "variance");
  const Isa chosen = parse_isa(isa);
  nb::gil_scoped_release release;
  elu_norm_forward(input.data(), rows, columns, activate, weight.data(), bias.data(), eps, z.data(),
                   output.data(), mean.data(), variance.data(), chosen, threads);
}

void norm_backward(In2<float> gradient, In2<float> z, bool activate, In1<float> weight, float eps,
                   In1<float> mean, In1<float> variance, Result grad_input, Result grad_weight,
                   Result grad_bias, int threads, const std::string& isa) {
  const std::size_t rows = z.shape(0), columns = z.shape(1);
  require(rows > 0 && columns > 0, "z is empty");
  require_columns(columns, "z");
  require_between(eps, 1e-30, 1e15, "eps");
  require_size(gradient, z.size(), "gradient");
  require_size(weight, columns, "weight");
  require_size(mean, columns, "mean");
  require_size(variance, columns, "variance");
  require_size(grad_input, z.size(), "grad_input");
  require_size(grad_weight, columns, "grad_weight");
  require_size(grad_bias, columns, "grad_bias");
  const Isa chosen = parse_isa(isa);
  nb::gil_scoped_release release;
  elu_norm_backward(gradient.data(), z.data(), rows, columns, activate, weight.data(), eps,
                    mean.data(), variance.data(), grad_input.data(), grad_weight.data(),
                    grad_bias.data(), chosen, threads);
}

}  // namespace

void bind_training(nb::module_& m) {
  using namespace nb::literals;
  m.def("xconv_apply", &forward, "x"_a.noconvert(), "lift"_a.noconvert(), "features"_a.noconvert(),
        "neighbors"_a.noconvert(), "depthwise"_a.noconvert(), "output"_a.noconvert(),
        "threads"_a = 1, "isa"_a = "auto");
  m.def("xconv_apply_backward", &backward, "x"_a.noconvert(), "lift"_a.noconvert(),
        "features"_a.noconvert(), "neighbors"_a.noconvert(), "depthwise"_a.noconvert(),
        "gradient"_a.noconvert(), "grad_x"_a.noconvert(), "grad_lift"_a.noconvert(),
        "grad_features"_a.noconvert(), "grad_depthwise"_a.noconvert(), "threads"_a = 1,
        "isa"_a = "auto");
  m.def("column_maps", &column_maps, "x"_a.noconvert(), "weight"_a.noconvert(),
        "output"_a.noconvert(), "threads"_a = 1, "isa"_a = "auto");
  m.def("column_maps_backward", &column_maps_backward, "x"_a.noconvert(), "weight"_a.noconvert(),
        "gradient"_a.noconvert(), "grad_x"_a.noconvert(), "grad_weight"_a.noconvert(),
        "threads"_a = 1, "isa"_a = "auto");
  m.def("elu_norm", &norm_forward, "input"_a.noconvert(), "activate"_a, "weight"_a.noconvert(),
        "bias"_a.noconvert(), "eps"_a, "z"_a.noconvert(), "output"_a.noconvert(),
        "mean"_a.noconvert(), "variance"_a.noconvert(), "threads"_a = 1, "isa"_a = "auto");
  m.def("elu_norm_backward", &norm_backward, "gradient"_a.noconvert(), "z"_a.noconvert(),
        "activate"_a, "weight"_a.noconvert(), "eps"_a, "mean"_a.noconvert(),
        "variance"_a.noconvert(), "grad_input"_a.noconvert(), "grad_weight"_a.noconvert(),
        "grad_bias"_a.noconvert(), "threads"_a = 1, "isa"_a = "auto");
}

}  // namespace segloc::bindings
