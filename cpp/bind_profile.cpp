#include <map>

#include "bindings.h"
#include "finite.h"
#include "perceptron.h"
#include "profile.h"

#include <nanobind/stl/map.h>

namespace segloc::bindings {
namespace {

constexpr std::size_t kFewest = 32;
constexpr float kLargest = 1e15f;

Out<float> profiles(In3<float> prepared, In1<float> heights, int threads) {
  const std::size_t P = prepared.shape(0), N = prepared.shape(1);
  require(prepared.shape(2) == 3, "prepared must have shape (P, N, 3)");
  require(N >= kFewest, "prepared segments need at least 32 points");
  require(heights.size() == P, "heights must have shape (P,)");
  std::vector<float> output(P * profile_size());
  {
    nb::gil_scoped_release release;
    require(all_below(prepared.data(), prepared.size(), kLargest) &&
                all_below(heights.data(), P, kLargest),
            "prepared or heights have values that are not finite or beyond 1e15");
    shape_profiles(prepared.data(), heights.data(), P, N, threads, output.data());
  }
  return to_numpy(std::move(output), {P, profile_size()});
}

using Array = nb::ndarray<const float, nb::c_contig, nb::device::cpu>;

void construct(Perceptron* self, const std::map<std::string, Array>& tensors, float limit,
               const std::string& isa) {
  Tensors views;
  for (const auto& [name, array] : tensors) {
    TensorView view{array.data(), {}};
    for (std::size_t i = 0; i < array.ndim(); ++i) view.shape.push_back(array.shape(i));
    views.emplace(name, std::move(view));
  }
  require(limit > 0, "limit must be positive");
  new (self) Perceptron(views, limit, parse_isa(isa));
}

Out<float> run(const Perceptron& perceptron, In2<float> input, int threads) {
  const std::size_t rows = input.shape(0);
  require(input.shape(1) == perceptron.inputs(),
          "input must have shape (P, " + std::to_string(perceptron.inputs()) + ")");
  std::vector<float> output(rows * perceptron.outputs());
  {
    nb::gil_scoped_release release;
    require(all_below(input.data(), input.size(), kLargest), "input has values that are not finite");
    perceptron.run(input.data(), rows, threads, output.data());
  }
  return to_numpy(std::move(output), {rows, perceptron.outputs()});
}

}  // namespace

void bind_profile(nb::module_& m) {
  using namespace nb::literals;
  m.def("shape_profiles", &profiles, "prepared"_a.noconvert(), "heights"_a.noconvert(),
        "threads"_a = 0);
  nb::class_<Perceptron>(m, "Perceptron")
      .def("__init__", &construct, "tensors"_a, "limit"_a, "isa"_a = "auto")
      .def("run", &run, "input"_a.noconvert(), "threads"_a = 0)
      .def_prop_ro("inputs", &Perceptron::inputs)
      .def_prop_ro("outputs", &Perceptron::outputs);
}

}  // namespace segloc::bindings
