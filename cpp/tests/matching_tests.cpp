// Descriptor search on every instruction set, and forests.
#include <cstdint>

#include "proposals/matching/knn.h"
#include "proposals/matching/random_forest.h"
#include "tests/check.h"

namespace segloc {
namespace {

void search(Isa isa) {
  for (const std::size_t dim : {4, 7, 16, 66}) {
    for (const std::size_t count : {1, 3, 1000}) {
      const auto database = random_floats(count * dim, -1, 1, 9),
                 queries = random_floats(5 * dim, -1, 1, 10);
      const std::size_t columns = count < 200 ? count : 200;
      std::vector<int64_t> indices(5 * columns);
      std::vector<float> distances(5 * columns);
      nearest_descriptors(queries.data(), 5, database.data(), count, dim, columns, isa, 2,
                          indices.data(), distances.data());
      digest(isa, "knn", indices);
      digest(isa, "knn", distances);
      for (std::size_t i = 1; i < columns; ++i) CHECK(distances[i - 1] <= distances[i]);
    }
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
  const auto query = random_floats(5 * dim, 0, 1, 2), map = random_floats(7 * dim, 0, 1, 3);
  std::vector<int64_t> rows(333), columns(333);
  for (std::size_t i = 0; i < 333; ++i) {
    rows[i] = static_cast<int64_t>(i % 5);
    columns[i] = static_cast<int64_t>(i % 7);
  }
  const PairTask task = {query.data(), map.data(), dim, rows.data(), columns.data(), 333};
  std::vector<float> features(333 * 7), apart(333), together(333);
  pair_features(task, layout, 2, features.data());
  forest.predict(features.data(), 333, 2, apart.data());
  forest.predict_pairs(task, layout, 2, together.data());
  CHECK(apart == together);
  digest("forest", apart);
  child[3] = 2;
  CHECK_THROWS(Forest(arrays, 7));
  child[3] = 5;
  CHECK_THROWS(Forest(arrays, 7));
}

}  // namespace
}  // namespace segloc

void matching_tests() {
  segloc::forests();
  for (const segloc::Isa isa : instruction_sets()) {
    segloc::search(isa);
  }
}
