// The networks on every instruction set.
#include <cmath>
#include <cstdint>
#include <map>
#include <string>

#include "descriptors/network/network.h"
#include "descriptors/network/perceptron.h"
#include "descriptors/network/voxel_network.h"
#include "descriptors/voxel_shape.h"
#include "tests/check.h"

namespace segloc {
namespace {

const std::vector<int64_t> kOffsets = {0, 0, 1, 3, 40, 400, 1000};
constexpr std::size_t kSegments = 6;

void voxel_network(Isa isa) {
  std::map<std::string, std::vector<float>> values;
  Tensors tensors;
  const auto add = [&](const std::string& name, const std::vector<std::size_t>& shape) {
    std::size_t size = 1;
    for (const std::size_t n : shape) size *= n;
    values[name] = random_floats(size, -0.1f, 0.1f, static_cast<unsigned>(size));
    tensors[name] = {values[name].data(), shape};
  };
  add("conv1.weight", {3, 3, 3, 1, 32});
  add("conv2.weight", {3, 3, 3, 32, 32});
  add("conv3.weight", {3, 3, 3, 32, 64});
  add("fc1.weight", {256 * 64 + 3, 32});
  add("fc2.weight", {32, 32});
  for (const char* name : {"conv1.bias", "conv2.bias", "fc1.bias", "fc2.bias"}) add(name, {32});
  add("conv3.bias", {64});
  const VoxelNetwork network(tensors, isa);
  const auto points = random_floats(3 * 1000, -3, 3, 4);
  const VoxelShapes shapes = voxel_shapes(points.data(), kOffsets.data(), kSegments, 2);
  std::vector<float> vectors(kSegments * network.dim(), NAN);
  network.describe(shapes.voxels.data(), shapes.offsets.data(), shapes.scales.data(), kSegments, 2,
                   vectors.data());
  CHECK(all_finite(vectors));
  digest(isa, "voxel_shapes", shapes.voxels);
  digest(isa, "voxel_network", vectors);
  tensors.erase("fc2.bias");
  CHECK_THROWS(VoxelNetwork(tensors, isa));
}

void perceptron(Isa isa) {
  std::map<std::string, std::vector<float>> values;
  Tensors tensors;
  const auto add = [&](const std::string& name, const std::vector<std::size_t>& shape) {
    std::size_t size = 1;
    for (const std::size_t n : shape) size *= n;
    values[name] = random_floats(size, -0.3f, 0.3f, static_cast<unsigned>(values.size()));
    tensors[name] = {values[name].data(), shape};
  };
  for (const char* name : {"input.mean", "input.scale"}) add(name, {19});
  const std::vector<std::size_t> widths = {19, 33, 7};
  for (std::size_t l = 0; l < 2; ++l) {
    const std::string name = "hidden." + std::to_string(l);
    add(name + ".weight", {widths[l], widths[l + 1]});
    for (const char* part : {".bias", ".scale", ".shift"}) add(name + part, {widths[l + 1]});
  }
  add("output.weight", {7, 5});
  add("output.bias", {5});
  const Perceptron network(tensors, 6.0f, isa);
  CHECK(network.inputs() == 19 && network.outputs() == 5);
  const auto input = random_floats(70 * 19, -1e15f, 1e15f, 9);
  std::vector<float> one(70 * 5, NAN), two(one), alone(5, NAN);
  network.run(input.data(), 70, 1, one.data());
  network.run(input.data(), 70, 3, two.data());
  network.run(input.data() + 69 * 19, 1, 1, alone.data());
  CHECK(one == two && all_finite(one));
  digest(isa, "perceptron", one);
  CHECK(std::equal(alone.begin(), alone.end(), one.begin() + 69 * 5));
  tensors.erase("hidden.0.weight");
  CHECK_THROWS(Perceptron(tensors, 6.0f, isa));
}

// Random tensors of the right shapes for a layer table.
class RandomNetwork {
 public:
  explicit RandomNetwork(const std::vector<LayerSpec>& layers) {
    std::size_t in = 0;
    for (std::size_t l = 0; l < layers.size(); ++l) {
      const std::size_t K = layers[l].neighbors, C = layers[l].channels;
      const std::size_t c = l == 0 ? C / 2 : in / 4, m = l == 0 ? 4 : (C + in - 1) / in;
      const std::string base = "layers." + std::to_string(l) + ".";
      add(base + "lift1.weight", {3, c});
      dense(base + "lift2", c, c, true);
      add(base + "x0.weight", {3 * K, K, K});
      for (const char* x : {"x1", "x2"}) {
        add(base + x + ".weight", {K, K, K});
        add(base + x + ".bias", {K, K});
      }
      add(base + "depthwise.weight", {K, c + in, m});
      add(base + "pointwise.weight", {(c + in) * m, C});
      add(base + "pointwise.scale", {C});
      add(base + "pointwise.shift", {C});
      in = C;
    }
    const std::size_t g = in / 4;
    add("global1.weight", {3, g});
    dense("global2", g, g, true);
    dense("fc1", in + g, 32, false);
    dense("fc2", 32, 24, false);
    dense("fc3", 24, 16, false);
    dense("quality", 16, 1, false);
  }

  const Tensors& tensors() const { return tensors_; }

 private:
  void add(const std::string& name, const std::vector<std::size_t>& shape) {
    std::size_t size = 1;
    for (const std::size_t s : shape) size *= s;
    memory_.push_back(random_floats(size, -0.2f, 0.2f, unsigned(memory_.size())));
    tensors_[name] = {memory_.back().data(), shape};
  }

  void dense(const std::string& name, std::size_t in, std::size_t out, bool normalised) {
    add(name + ".weight", {in, out});
    add(name + ".bias", {out});
    if (!normalised) return;
    add(name + ".scale", {out});
    add(name + ".shift", {out});
  }

  std::vector<std::vector<float>> memory_;
  Tensors tensors_;
};

void inference(Isa isa) {
  const std::vector<LayerSpec> layers = {
      {160, 8, 1, 32}, {96, 10, 2, 64}, {16, 12, 3, 128}, {4, 16, 1, 256}};
  const RandomNetwork random(layers);
  const Network network(layers, 256, random.tensors(), isa);
  const auto prepared = random_floats(7 * 256 * 3, -2.0f, 2.0f, 11);
  std::vector<float> one(7 * network.dim()), two(one), quality(7);
  network.describe(prepared.data(), 7, 1, one.data(), quality.data());
  network.describe(prepared.data(), 7, 3, two.data(), quality.data());
  CHECK(one == two);
  CHECK(all_finite(one));
  digest(isa, "network", one);
  for (const float v : quality) CHECK(v >= 0.0f && v <= 1.0f);
  network.describe(prepared.data(), 0, 2, one.data(), quality.data());
  Tensors wrong = random.tensors();
  wrong.erase("fc3.weight");
  CHECK_THROWS(Network(layers, 256, wrong, isa));
}

}  // namespace
}  // namespace segloc

void network_tests() {
  for (const segloc::Isa isa : instruction_sets()) {
    segloc::voxel_network(isa);
    segloc::perceptron(isa);
    segloc::inference(isa);
  }
}
