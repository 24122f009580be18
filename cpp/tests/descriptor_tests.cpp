// Hand-made descriptors, forests and the voxel network, on odd segments and every instruction set.
#include <cmath>
#include <map>
#include <string>

#include "check.h"
#include "esf.h"
#include "forest.h"
#include "gestalt.h"
#include "moments.h"
#include "perceptron.h"
#include "profile.h"
#include "voxel_network.h"

namespace segloc {
namespace {

const std::vector<int64_t> kOffsets = {0, 0, 1, 3, 40, 400, 1000};
constexpr std::size_t kSegments = 6;

void hand_made() {
  for (const float size : {0.0f, 3.0f, 1e14f}) {
    const auto points = random_floats(3 * 1000, -size, size, 1);
    std::vector<double> means(3 * kSegments), values(3 * kSegments);
    segment_moments(points.data(), kOffsets.data(), kSegments, 2, means.data(), values.data());
    for (const double v : values) CHECK(v >= 0 && std::isfinite(v));
    std::vector<float> shape(kSegments * kEsfSize, NAN), rings(kSegments * kGestaltSize, NAN);
    esf(points.data(), kOffsets.data(), kSegments, 500, 3, 2, shape.data());
    CHECK(all_finite(shape));
    gestalt(points.data(), kOffsets.data(), kSegments, 2.0, 2, rings.data());
    CHECK(all_finite(rings));
  }
}

void forests() {
  const std::vector<int32_t> roots = {0, 3}, feature = {0, 0, 0, 6, 0, 0};
  const std::vector<float> threshold = {0.1f, 0.0f, 1.0f, 2.0f, 1.0f, 0.0f};
  std::vector<int32_t> child = {1, -1, -1, 4, -1, -1};
  const PairLayout layout = {1, true, 4};
  const std::size_t dim = 9;
  CHECK(layout.features(dim) == 7);
  const ForestArrays arrays = {roots.data(),     roots.size(), feature.data(),
                               threshold.data(), child.data(), child.size()};
  const Forest forest(arrays, 7);
  const auto query = random_floats(5 * dim, 0, 1, 2), site = random_floats(7 * dim, 0, 1, 3);
  std::vector<int64_t> rows(333), columns(333);
  for (std::size_t i = 0; i < 333; ++i) {
    rows[i] = static_cast<int64_t>(i % 5);
    columns[i] = static_cast<int64_t>(i % 7);
  }
  const PairTask task = {query.data(), site.data(), dim, rows.data(), columns.data(), 333};
  std::vector<float> features(333 * 7), apart(333), together(333);
  pair_features(task, layout, 2, features.data());
  forest.predict(features.data(), 333, 2, apart.data());
  forest.predict_pairs(task, layout, 2, together.data());
  CHECK(apart == together);
  child[3] = 2;
  CHECK_THROWS(Forest(arrays, 7));
  child[3] = 5;
  CHECK_THROWS(Forest(arrays, 7));
}

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
  tensors.erase("fc2.bias");
  CHECK_THROWS(VoxelNetwork(tensors, isa));
}

void profiles() {
  constexpr std::size_t kClouds = 37;  // neither a whole number of batches nor of tasks
  for (const std::size_t count : {32, 100, 256}) {
    for (const float size : {0.0f, 3.0f, 1e15f}) {
      const auto points = random_floats(3 * count * kClouds, -size, size, 5);
      const auto heights = random_floats(kClouds, -1, 9, 6);
      std::vector<float> one(kClouds * profile_size(), NAN), two(one);
      shape_profiles(points.data(), heights.data(), kClouds, count, 1, one.data());
      shape_profiles(points.data(), heights.data(), kClouds, count, 3, two.data());
      CHECK(one == two && all_finite(one));
    }
  }
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
  CHECK(std::equal(alone.begin(), alone.end(), one.begin() + 69 * 5));
  tensors.erase("hidden.0.weight");
  CHECK_THROWS(Perceptron(tensors, 6.0f, isa));
}

}  // namespace
}  // namespace segloc

void descriptor_tests() {
  segloc::hand_made();
  segloc::forests();
  segloc::profiles();
  for (const segloc::Isa isa : instruction_sets()) {
    segloc::voxel_network(isa);
    segloc::perceptron(isa);
  }
}
