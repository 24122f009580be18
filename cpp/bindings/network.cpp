// Descriptor networks.
#include "descriptors/network/network.h"

#include "bindings/bindings.h"
#include "bindings/tensors.h"
#include "descriptors/network/neighbors.h"
#include "descriptors/network/perceptron.h"
#include "descriptors/network/voxel_network.h"

namespace segloc::bindings {
namespace {

Out<int64_t> neighbors(In3<float> points, std::size_t sources, std::size_t queries, int k,
                       int dilation, int threads, const std::string& isa) {
  const std::size_t clouds = points.shape(0), n = points.shape(1);
  require(points.shape(2) == 3, "points must have shape (P, N, 3)");
  require(queries > 0 && queries <= sources && sources <= n && n <= 65535,
          "need 0 < queries <= sources <= N <= 65535");
  require(k > 0 && dilation > 0 && k <= 65535 && dilation <= 65535 &&
              static_cast<std::size_t>(k) * static_cast<std::size_t>(dilation) <= sources,
          "neighbors * dilation must be from 1 to the number of sources");
  const Isa chosen = parse_isa(isa);
  const auto K = static_cast<std::size_t>(k);
  std::vector<int64_t> indices(clouds * queries * K);
  {
    nb::gil_scoped_release release;
    require_usable(points.data(), points.size(), "points", kLargestPrepared);
    dilated_neighbors(points.data(), clouds, n, sources, queries, k, dilation, chosen, threads,
                      indices.data());
  }
  return to_numpy(std::move(indices), {clouds, queries, K});
}

using LayerRow = std::tuple<int, int, int, int>;

void construct_network(Network* self, const std::vector<LayerRow>& layers,
                       const TensorArrays& tensors, std::size_t points, const std::string& isa) {
  std::vector<LayerSpec> specs;
  for (const auto& [n, k, d, c] : layers) specs.push_back({n, k, d, c});
  new (self) Network(specs, points, views_of(tensors), parse_isa(isa));
}

void check_prepared(const Network& network, const In3<float>& prepared) {
  require(prepared.shape(1) == network.points() && prepared.shape(2) == 3,
          "prepared must have shape (P, " + std::to_string(network.points()) + ", 3)");
}

nb::tuple describe_prepared(const Network& network, In3<float> prepared, int threads) {
  check_prepared(network, prepared);
  const std::size_t P = prepared.shape(0), dim = network.dim();
  std::vector<float> vectors(P * dim), quality(P);
  {
    nb::gil_scoped_release release;
    require_usable(prepared.data(), prepared.size(), "prepared", kLargestPrepared);
    network.describe(prepared.data(), P, threads, vectors.data(), quality.data());
  }
  return nb::make_tuple(to_numpy(std::move(vectors), {P, dim}), to_numpy(std::move(quality)));
}

Out<float> activations(const Network& network, In3<float> prepared, std::size_t layer) {
  check_prepared(network, prepared);
  require(layer < network.layers().size(), "there is no such layer");
  const LayerSpec& spec = network.layers()[layer];
  const std::size_t P = prepared.shape(0), N = static_cast<std::size_t>(spec.points);
  const std::size_t C = static_cast<std::size_t>(spec.channels);
  std::vector<float> output(P * N * C);
  {
    nb::gil_scoped_release release;
    require_usable(prepared.data(), prepared.size(), "prepared", kLargestPrepared);
    network.activations(prepared.data(), P, layer, output.data());
  }
  return to_numpy(std::move(output), {P, N, C});
}

void construct_voxel_network(VoxelNetwork* self, const TensorArrays& tensors,
                             const std::string& isa) {
  new (self) VoxelNetwork(views_of(tensors), parse_isa(isa));
}

Out<float> describe_voxels(const VoxelNetwork& network, In1<int32_t> voxels, In1<int64_t> offsets,
                           In2<float> scales, int threads) {
  check_offsets(offsets, voxels.size());
  const std::size_t P = offsets.size() - 1;
  require(scales.shape(0) == P && scales.shape(1) == 3, "scales must have shape (P, 3)");
  require_usable(scales.data(), scales.size(), "scales");
  for (std::size_t i = 0; i < voxels.size(); ++i) {
    const int32_t v = voxels.data()[i];
    require(v >= 0 && static_cast<std::size_t>(v) < kShapeVoxels, "a voxel is outside the grid");
  }
  std::vector<float> vectors(P * network.dim());
  {
    nb::gil_scoped_release release;
    network.describe(voxels.data(), offsets.data(), scales.data(), P, threads, vectors.data());
  }
  return to_numpy(std::move(vectors), {P, network.dim()});
}

void construct_perceptron(Perceptron* self, const TensorArrays& tensors, float limit,
                          const std::string& isa) {
  require_between(limit, 1e-6, 1e15, "limit");
  new (self) Perceptron(views_of(tensors), limit, parse_isa(isa));
}

Out<float> run_perceptron(const Perceptron& perceptron, In2<float> input, int threads) {
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

void bind_network(nb::module_& m) {
  using namespace nb::literals;
  m.def("dilated_neighbors", &neighbors, "points"_a.noconvert(), "sources"_a, "queries"_a,
        "neighbors"_a, "dilation"_a, "threads"_a = 0, "isa"_a = "auto");
  nb::class_<Network>(m, "Network")
      .def("__init__", &construct_network, "layers"_a, "tensors"_a, "points"_a = 256,
           "isa"_a = "auto")
      .def("describe", &describe_prepared, "prepared"_a.noconvert(), "threads"_a = 0)
      .def("activations", &activations, "prepared"_a.noconvert(), "layer"_a)
      .def_prop_ro("points", &Network::points)
      .def_prop_ro("dim", &Network::dim);
  nb::class_<VoxelNetwork>(m, "VoxelNetwork")
      .def("__init__", &construct_voxel_network, "tensors"_a, "isa"_a = "auto")
      .def("describe", &describe_voxels, "voxels"_a.noconvert(), "offsets"_a.noconvert(),
           "scales"_a.noconvert(), "threads"_a = 0)
      .def_prop_ro("dim", &VoxelNetwork::dim);
  nb::class_<Perceptron>(m, "Perceptron")
      .def("__init__", &construct_perceptron, "tensors"_a, "limit"_a, "isa"_a = "auto")
      .def("run", &run_perceptron, "input"_a.noconvert(), "threads"_a = 0)
      .def_prop_ro("inputs", &Perceptron::inputs)
      .def_prop_ro("outputs", &Perceptron::outputs);
}

}  // namespace segloc::bindings
