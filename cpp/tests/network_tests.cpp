// Sampling, preparation, neighbours, the network and descriptor search, on every instruction set.
#include <cmath>
#include <string>

#include "check.h"
#include "fps.h"
#include "knn.h"
#include "network.h"
#include "prepare.h"

namespace segloc {
namespace {

void sampling(Isa isa) {
  for (const std::size_t n : {1, 5, 63, 64, 65, 256, 300}) {
    const auto points = random_floats(3 * 4 * n, -3.0f, 3.0f, 7);
    std::vector<int32_t> order(4 * n), portable(4 * n);
    farthest_points(points.data(), 4, n, n, isa, 2, order.data());
    farthest_points(points.data(), 4, n, n, Isa::portable, 1, portable.data());
    CHECK(order == portable);
  }
  const std::vector<int64_t> offsets = {0, 0, 1, 4, 300, 6000};
  const auto points = random_floats(3 * 6000, -5.0f, 5.0f, 8);
  for (const Alignment alignment : {Alignment::none, Alignment::pca2d, Alignment::pca3d}) {
    std::vector<float> out(5 * 256 * 3, NAN);
    prepare_segments(points.data(), offsets.data(), 5, 256, alignment, isa, 2, out.data());
    CHECK(all_finite(out));
  }
}

void search(Isa isa) {
  for (const std::size_t dim : {4, 7, 16, 66}) {
    for (const std::size_t count : {1, 3, 1000}) {
      const auto database = random_floats(count * dim, -1, 1, 9), queries = random_floats(5 * dim, -1, 1, 10);
      const std::size_t columns = count < 200 ? count : 200;
      std::vector<int64_t> indices(5 * columns);
      std::vector<float> distances(5 * columns);
      nearest_descriptors(queries.data(), 5, database.data(), count, dim, columns, isa, 2,
                          indices.data(), distances.data());
      for (std::size_t i = 1; i < columns; ++i) CHECK(distances[i - 1] <= distances[i]);
    }
  }
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
  const std::vector<LayerSpec> layers = {{160, 8, 1, 32}, {96, 10, 2, 64}, {16, 12, 3, 128}, {4, 16, 1, 256}};
  const RandomNetwork random(layers);
  const Network network(layers, 256, random.tensors(), isa);
  const auto prepared = random_floats(7 * 256 * 3, -2.0f, 2.0f, 11);
  std::vector<float> one(7 * network.dim()), two(one), quality(7);
  network.describe(prepared.data(), 7, 1, one.data(), quality.data());
  network.describe(prepared.data(), 7, 3, two.data(), quality.data());
  CHECK(one == two);
  CHECK(all_finite(one));
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
    segloc::sampling(isa);
    segloc::search(isa);
    segloc::inference(isa);
  }
}
