// The shape profiles and the perceptron that reads them.
#include "bind_tensors.h"
#include "bindings.h"
#include "perceptron.h"
#include "profile.h"

namespace segloc::bindings {
namespace {

Out<float> profiles(In3<float> prepared, In1<float> heights, int threads) {
  const std::size_t P = prepared.shape(0), N = prepared.shape(1);
  require(prepared.shape(2) == 3, "prepared must have shape (P, N, 3)");
  require(N >= kPairedPoints,
          "prepared segments need at least " + std::to_string(kPairedPoints) + " points");
  require(heights.size() == P, "heights must have shape (P,)");
  std::vector<float> output(P * profile_size());
  {
    nb::gil_scoped_release release;
    require_usable(prepared.data(), prepared.size(), "prepared", kLargestPrepared);
    require_usable(heights.data(), P, "heights");
    shape_profiles(prepared.data(), heights.data(), P, N, threads, output.data());
  }
  return to_numpy(std::move(output), {P, profile_size()});
}

void construct(Perceptron* self, const TensorArrays& tensors, float limit,
               const std::string& isa) {
  require(limit > 0, "limit must be positive");
  new (self) Perceptron(views_of(tensors), limit, parse_isa(isa));
}

Out<float> run(const Perceptron& perceptron, In2<float> input, int threads) {
  const std::size_t rows = input.shape(0);
  require(input.shape(1) == perceptron.inputs(),
          "input must have shape (P, " + std::to_string(perceptron.inputs()) + ")");
  std::vector<float> output(rows * perceptron.outputs());
  {
    nb::gil_scoped_release release;
    require_usable(input.data(), input.size(), "input");
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
