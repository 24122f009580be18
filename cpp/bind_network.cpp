#include "bind_tensors.h"
#include "bindings.h"
#include "fps.h"
#include "knn.h"
#include "match_order.h"
#include "neighbors.h"
#include "network.h"
#include "prepare.h"

namespace segloc::bindings {
namespace {

Out<int32_t> fps(In3<float> points, std::size_t samples, int threads, const std::string& isa) {
  const std::size_t clouds = points.shape(0), n = points.shape(1);
  require(points.shape(2) == 3, "points must have shape (P, N, 3)");
  require(samples <= n, "samples must not exceed the number of points, " + std::to_string(n));
  require(n < (std::size_t{1} << 31), "too many points");
  const Isa chosen = parse_isa(isa);
  std::vector<int32_t> order(clouds * samples);
  {
    nb::gil_scoped_release release;
    require_usable(points.data(), clouds * n * 3, "points");
    farthest_points(points.data(), clouds, n, samples, chosen, threads, order.data());
  }
  return to_numpy(std::move(order), {clouds, samples});
}

Alignment parse_alignment(const std::string& name) {
  if (name == "none") return Alignment::none;
  if (name == "pca2d") return Alignment::pca2d;
  if (name == "pca3d") return Alignment::pca3d;
  throw std::invalid_argument("alignment must be none, pca2d or pca3d, not '" + name + "'");
}

Out<float> prepare(In2<float> points, In1<int64_t> offsets, std::size_t count,
                   const std::string& alignment, int threads, const std::string& isa) {
  check_segments(points, offsets);
  require(count > 0 && count <= kThinnedPoints,
          "count must be from 1 to " + std::to_string(kThinnedPoints));
  const Alignment how = parse_alignment(alignment);
  const Isa chosen = parse_isa(isa);
  const std::size_t segments = offsets.size() - 1;
  std::vector<float> output(segments * count * 3);
  {
    nb::gil_scoped_release release;
    require_usable(points.data(), points.size(), "points");
    prepare_segments(points.data(), offsets.data(), segments, count, how, chosen, threads,
                     output.data());
  }
  return to_numpy(std::move(output), {segments, count, 3});
}

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

nb::tuple knn(In2<float> queries, In2<float> database, std::size_t k, int threads,
              const std::string& isa) {
  const std::size_t Q = queries.shape(0), M = database.shape(0), dim = database.shape(1);
  require(queries.shape(1) == dim, "queries and database differ in their number of columns");
  require(dim > 0, "descriptors must have at least one column");
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

// An index and the array that it reads.
struct BoundIndex {
  BoundIndex(In2<float> rows, std::size_t lists, int threads, const std::string& isa)
      : database(rows),
        index(rows.data(), rows.shape(0), rows.shape(1), lists, parse_isa(isa), threads) {}

  In2<float> database;
  DescriptorIndex index;
};

void construct_index(BoundIndex* self, In2<float> database, std::size_t lists, int threads,
                     const std::string& isa) {
  require(database.shape(1) > 0, "descriptors must have at least one column");
  require(lists > 0, "there must be at least one list");
  require(database.shape(0) < (std::size_t{1} << 31), "the database is too large");
  require_usable(database.data(), database.size(), "database");
  new (self) BoundIndex(database, lists, threads, isa);
}

nb::tuple search(const BoundIndex& bound, In2<float> queries, std::size_t k, std::size_t probes,
                 int threads) {
  const DescriptorIndex& index = bound.index;
  require(queries.shape(1) == index.dim(), "queries and database differ in their number of columns");
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
  std::vector<int64_t> order;
  {
    nb::gil_scoped_release release;
    order = order_matches(query.data(), map.data(), score.data(), n);
  }
  return to_numpy(std::move(order));
}

using LayerRow = std::tuple<int, int, int, int>;

void construct(Network* self, const std::vector<LayerRow>& layers,
               const TensorArrays& tensors, std::size_t points,
               const std::string& isa) {
  std::vector<LayerSpec> specs;
  for (const auto& [n, k, d, c] : layers) specs.push_back({n, k, d, c});
  new (self) Network(specs, points, views_of(tensors), parse_isa(isa));
}

void check_prepared(const Network& network, const In3<float>& prepared) {
  require(prepared.shape(1) == network.points() && prepared.shape(2) == 3,
          "prepared must have shape (P, " + std::to_string(network.points()) + ", 3)");
}

nb::tuple describe(const Network& network, In3<float> prepared, int threads) {
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

}  // namespace

void bind_network(nb::module_& m) {
  using namespace nb::literals;
  m.def("fps", &fps, "points"_a.noconvert(), "samples"_a, "threads"_a = 0, "isa"_a = "auto");
  m.def("prepare_segments", &prepare, "points"_a.noconvert(), "offsets"_a.noconvert(),
        "count"_a = 256, "alignment"_a = "pca2d", "threads"_a = 0, "isa"_a = "auto");
  m.def("dilated_neighbors", &neighbors, "points"_a.noconvert(), "sources"_a, "queries"_a,
        "neighbors"_a, "dilation"_a, "threads"_a = 0, "isa"_a = "auto");
  m.def("knn", &knn, "queries"_a.noconvert(), "database"_a.noconvert(), "k"_a, "threads"_a = 0,
        "isa"_a = "auto");
  nb::class_<BoundIndex>(m, "DescriptorIndex")
      .def("__init__", &construct_index, "database"_a.noconvert(), "lists"_a, "threads"_a = 0,
           "isa"_a = "auto")
      .def("search", &search, "queries"_a.noconvert(), "k"_a, "probes"_a, "threads"_a = 0)
      .def("__len__", [](const BoundIndex& bound) { return bound.index.size(); })
      .def_prop_ro("lists", [](const BoundIndex& bound) { return bound.index.lists(); });
  m.def("order_matches", &order_matches_, "query"_a.noconvert(), "map"_a.noconvert(),
        "score"_a.noconvert());
  nb::class_<Network>(m, "Network")
      .def("__init__", &construct, "layers"_a, "tensors"_a, "points"_a = 256, "isa"_a = "auto")
      .def("describe", &describe, "prepared"_a.noconvert(), "threads"_a = 0)
      .def("activations", &activations, "prepared"_a.noconvert(), "layer"_a)
      .def_prop_ro("points", &Network::points)
      .def_prop_ro("dim", &Network::dim);
  m.def("instruction_set", [](const std::string& isa) {
    const char* names[] = {"portable", "avx2", "avx512"};
    return std::string(names[static_cast<int>(parse_isa(isa))]);
  }, "isa"_a = "auto");
}

}  // namespace segloc::bindings
