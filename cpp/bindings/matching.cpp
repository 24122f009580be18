// Search among descriptors, and random forests over pairs of them.
#include <algorithm>
#include <cmath>

#include "bindings/bindings.h"
#include "proposals/matching/knn.h"
#include "proposals/matching/match_order.h"
#include "proposals/matching/random_forest.h"

namespace segloc::bindings {
namespace {

nb::tuple knn(In2<float> queries, In2<float> database, std::size_t k, int threads,
              const std::string& isa) {
  const std::size_t Q = queries.shape(0), M = database.shape(0), dim = database.shape(1);
  require(queries.shape(1) == dim, "queries and database differ in their number of columns");
  require(dim > 0, "descriptors must have at least one column");
  require_columns(dim, "database");
  require(M < (std::size_t{1} << 31), "the database is too large");
  const Isa chosen = parse_isa(isa);
  const std::size_t columns = std::min(k, M);
  std::vector<int64_t> indices(Q * columns);
  std::vector<float> distances(Q * columns);
  {
    nb::gil_scoped_release release;
    require_usable(queries.data(), queries.size(), "queries");
    require_usable(database.data(), database.size(), "database");
    nearest_descriptors(queries.data(), Q, database.data(), M, dim, columns, chosen, threads,
                        indices.data(), distances.data());
  }
  return nb::make_tuple(to_numpy(std::move(indices), {Q, columns}),
                        to_numpy(std::move(distances), {Q, columns}));
}

// An index and the arrays that it reads.
struct BoundIndex {
  BoundIndex(In2<float> rows, std::size_t lists, int threads, const std::string& isa)
      : arrays(nb::make_tuple(rows)),
        index(DescriptorRows(rows.data(), rows.shape(0), rows.shape(1)), lists, parse_isa(isa),
              threads) {}
  BoundIndex(In2<std::uint8_t> codes, In1<float> base, In1<float> step, std::size_t lists,
             int threads, const std::string& isa)
      : arrays(nb::make_tuple(codes, base, step)),
        index(DescriptorRows(codes.data(), base.data(), step.data(), codes.shape(0),
                             codes.shape(1)),
              lists, parse_isa(isa), threads) {}

  nb::tuple arrays;
  DescriptorIndex index;
};

void require_database(std::size_t rows, std::size_t columns, std::size_t lists) {
  require(columns > 0, "descriptors must have at least one column");
  require_columns(columns, "database");
  require(lists > 0, "lists: there must be at least one list");
  require(rows < (std::size_t{1} << 31), "the database is too large");
}

void construct_index(BoundIndex* self, In2<float> database, std::size_t lists, int threads,
                     const std::string& isa) {
  require_database(database.shape(0), database.shape(1), lists);
  require_usable(database.data(), database.size(), "database");
  new (self) BoundIndex(database, lists, threads, isa);
}

void construct_coded(BoundIndex* self, In2<std::uint8_t> codes, In1<float> base, In1<float> step,
                     std::size_t lists, int threads, const std::string& isa) {
  require_database(codes.shape(0), codes.shape(1), lists);
  require(base.size() == codes.shape(1) && step.size() == codes.shape(1),
          "base and step must have one number per column");
  require_usable(base.data(), base.size(), "base");
  require_usable(step.data(), step.size(), "step");
  new (self) BoundIndex(codes, base, step, lists, threads, isa);
}

nb::tuple search(const BoundIndex& bound, In2<float> queries, std::size_t k, std::size_t probes,
                 int threads) {
  const DescriptorIndex& index = bound.index;
  require(queries.shape(1) == index.dim(),
          "queries and database differ in their number of columns");
  const std::size_t Q = queries.shape(0), columns = std::min(k, index.size());
  std::vector<int64_t> indices(Q * columns);
  std::vector<float> distances(Q * columns);
  {
    nb::gil_scoped_release release;
    require_usable(queries.data(), queries.size(), "queries");
    index.search(queries.data(), Q, columns, probes, threads, indices.data(), distances.data());
  }
  return nb::make_tuple(to_numpy(std::move(indices), {Q, columns}),
                        to_numpy(std::move(distances), {Q, columns}));
}

Out<int64_t> order_matches_(In1<int64_t> query, In1<int64_t> map, In1<float> score) {
  const std::size_t n = score.size();
  require(query.size() == n && map.size() == n, "query, map and score must have the same length");
  require(n < (std::size_t{1} << 32), "there are too many matches");
  require(std::none_of(score.data(), score.data() + n, [](float s) { return std::isnan(s); }),
          "score has values that are not numbers");
  std::vector<int64_t> order;
  {
    nb::gil_scoped_release release;
    order = order_matches(query.data(), map.data(), score.data(), n);
  }
  return to_numpy(std::move(order));
}

using LayoutRow = std::tuple<std::size_t, bool, std::size_t>;

PairLayout checked_layout(const LayoutRow& row, std::size_t dim) {
  const PairLayout layout = {std::get<0>(row), std::get<1>(row), std::get<2>(row)};
  require_columns(dim, "query");
  require(layout.plain <= dim, "the layout has more plain values than the descriptors");
  const std::size_t rest = dim - layout.plain;
  require(layout.histogram == 0 ? rest == 0 : rest % layout.histogram == 0,
          "the layout's histograms do not fill the descriptors");
  return layout;
}

PairTask checked_pairs(const In2<float>& query, const In2<float>& map, const In1<int64_t>& rows,
                       const In1<int64_t>& columns) {
  require(query.shape(1) == map.shape(1), "query and map differ in their number of columns");
  require(rows.size() == columns.size(), "rows and columns must have the same length");
  for (std::size_t i = 0; i < rows.size(); ++i) {
    const int64_t r = rows.data()[i], c = columns.data()[i];
    require(r >= 0 && static_cast<std::size_t>(r) < query.shape(0) && c >= 0 &&
                static_cast<std::size_t>(c) < map.shape(0),
            "a pair names a descriptor that does not exist");
  }
  return {query.data(), map.data(), query.shape(1), rows.data(), columns.data(), rows.size()};
}

Out<float> pair_features_(In2<float> query, In2<float> map, In1<int64_t> rows, In1<int64_t> columns,
                          const LayoutRow& row, int threads) {
  const PairTask task = checked_pairs(query, map, rows, columns);
  const PairLayout layout = checked_layout(row, task.dim);
  const std::size_t F = layout.features(task.dim);
  std::vector<float> output(task.pairs * F);
  {
    nb::gil_scoped_release release;
    require_usable(query.data(), query.size(), "query");
    require_usable(map.data(), map.size(), "mapped");
    pair_features(task, layout, threads, output.data());
  }
  return to_numpy(std::move(output), {task.pairs, F});
}

void construct_forest(Forest* self, In1<int32_t> roots, In1<int32_t> feature, In1<float> threshold,
                      In1<int32_t> first_child, std::size_t features) {
  require(feature.size() == threshold.size() && feature.size() == first_child.size(),
          "feature, threshold and first_child must have the same length");
  const ForestArrays arrays = {roots.data(),     roots.size(),       feature.data(),
                               threshold.data(), first_child.data(), feature.size()};
  new (self) Forest(arrays, features);
}

Out<float> predict(const Forest& forest, In2<float> features, int threads) {
  require(features.shape(1) == forest.features(),
          "features must have shape (M, " + std::to_string(forest.features()) + ")");
  std::vector<float> output(features.shape(0));
  {
    nb::gil_scoped_release release;
    forest.predict(features.data(), features.shape(0), threads, output.data());
  }
  return to_numpy(std::move(output));
}

Out<float> predict_pairs(const Forest& forest, In2<float> query, In2<float> map, In1<int64_t> rows,
                         In1<int64_t> columns, const LayoutRow& row, int threads) {
  const PairTask task = checked_pairs(query, map, rows, columns);
  const PairLayout layout = checked_layout(row, task.dim);
  require(layout.features(task.dim) == forest.features(), "the layout does not fit the forest");
  std::vector<float> output(task.pairs);
  {
    nb::gil_scoped_release release;
    forest.predict_pairs(task, layout, threads, output.data());
  }
  return to_numpy(std::move(output));
}

}  // namespace

void bind_matching(nb::module_& m) {
  using namespace nb::literals;
  m.def("knn", &knn, "queries"_a.noconvert(), "database"_a.noconvert(), "k"_a, "threads"_a = 0,
        "isa"_a = "auto");
  nb::class_<BoundIndex>(m, "DescriptorIndex")
      .def("__init__", &construct_index, "database"_a.noconvert(), "lists"_a, "threads"_a = 0,
           "isa"_a = "auto")
      .def("__init__", &construct_coded, "codes"_a.noconvert(), "base"_a.noconvert(),
           "step"_a.noconvert(), "lists"_a, "threads"_a = 0, "isa"_a = "auto")
      .def("search", &search, "queries"_a.noconvert(), "k"_a, "probes"_a, "threads"_a = 0)
      .def("__len__", [](const BoundIndex& bound) { return bound.index.size(); })
      .def_prop_ro("lists", [](const BoundIndex& bound) { return bound.index.lists(); });
  m.def("order_matches", &order_matches_, "query"_a.noconvert(), "map"_a.noconvert(),
        "score"_a.noconvert());
  m.def("pair_features", &pair_features_, "query"_a.noconvert(), "mapped"_a.noconvert(),
        "rows"_a.noconvert(), "columns"_a.noconvert(), "layout"_a, "threads"_a = 0);
  nb::class_<Forest>(m, "Forest")
      .def("__init__", &construct_forest, "roots"_a.noconvert(), "feature"_a.noconvert(),
           "threshold"_a.noconvert(), "first_child"_a.noconvert(), "features"_a)
      .def("predict", &predict, "features"_a.noconvert(), "threads"_a = 0)
      .def("predict_pairs", &predict_pairs, "query"_a.noconvert(), "mapped"_a.noconvert(),
           "rows"_a.noconvert(), "columns"_a.noconvert(), "layout"_a, "threads"_a = 0)
      .def_prop_ro("features", &Forest::features);
}

}  // namespace segloc::bindings
