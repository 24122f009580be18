// Hand-made descriptors, and the forests over pairs of them.
#include "bind_tensors.h"
#include "bindings.h"
#include "esf.h"
#include "forest.h"
#include "gestalt.h"
#include "moments.h"
#include "voxel_network.h"

namespace segloc::bindings {
namespace {

nb::tuple moments(In2<float> points, In1<int64_t> offsets, int threads) {
  check_segments(points, offsets);
  const std::size_t P = offsets.size() - 1;
  std::vector<double> means(3 * P), eigenvalues(3 * P);
  {
    nb::gil_scoped_release release;
    require_usable(points.data(), points.size(), "points");
    segment_moments(points.data(), offsets.data(), P, threads, means.data(), eigenvalues.data());
  }
  return nb::make_tuple(to_numpy(std::move(means), {P, 3}),
                        to_numpy(std::move(eigenvalues), {P, 3}));
}

Out<float> shape_functions(In2<float> points, In1<int64_t> offsets, std::size_t triples,
                           uint64_t seed, int threads) {
  check_segments(points, offsets);
  require(triples > 0 && triples <= 1'000'000, "triples must be from 1 to 1000000");
  const std::size_t P = offsets.size() - 1;
  std::vector<float> output(P * kEsfSize);
  {
    nb::gil_scoped_release release;
    require_usable(points.data(), points.size(), "points");
    esf(points.data(), offsets.data(), P, triples, seed, threads, output.data());
  }
  return to_numpy(std::move(output), {P, kEsfSize});
}

Out<float> gestalt_(In2<float> points, In1<int64_t> offsets, double radius, int threads) {
  check_segments(points, offsets);
  require(radius > 0 && std::isfinite(radius), "radius must be positive");
  const std::size_t P = offsets.size() - 1;
  std::vector<float> output(P * kGestaltSize);
  {
    nb::gil_scoped_release release;
    require_usable(points.data(), points.size(), "points");
    gestalt(points.data(), offsets.data(), P, radius, threads, output.data());
  }
  return to_numpy(std::move(output), {P, kGestaltSize});
}

using LayoutRow = std::tuple<std::size_t, bool, std::size_t>;

PairLayout checked_layout(const LayoutRow& row, std::size_t dim) {
  const PairLayout layout = {std::get<0>(row), std::get<1>(row), std::get<2>(row)};
  require(layout.plain <= dim, "the layout has more plain values than the descriptors");
  const std::size_t rest = dim - layout.plain;
  require(layout.histogram == 0 ? rest == 0 : rest % layout.histogram == 0,
          "the layout's histograms do not fill the descriptors");
  return layout;
}

PairTask checked_pairs(const In2<float>& query, const In2<float>& site, const In1<int64_t>& rows,
                       const In1<int64_t>& columns) {
  require(query.shape(1) == site.shape(1), "query and map differ in their number of columns");
  require(rows.size() == columns.size(), "rows and columns must have the same length");
  for (std::size_t i = 0; i < rows.size(); ++i) {
    const int64_t r = rows.data()[i], c = columns.data()[i];
    require(r >= 0 && static_cast<std::size_t>(r) < query.shape(0) && c >= 0 &&
                static_cast<std::size_t>(c) < site.shape(0),
            "a pair names a descriptor that does not exist");
  }
  return {query.data(), site.data(), query.shape(1), rows.data(), columns.data(), rows.size()};
}

Out<float> pair_features_(In2<float> query, In2<float> site, In1<int64_t> rows,
                          In1<int64_t> columns, const LayoutRow& row, int threads) {
  const PairTask task = checked_pairs(query, site, rows, columns);
  const PairLayout layout = checked_layout(row, task.dim);
  const std::size_t F = layout.features(task.dim);
  std::vector<float> output(task.pairs * F);
  {
    nb::gil_scoped_release release;
    pair_features(task, layout, threads, output.data());
  }
  return to_numpy(std::move(output), {task.pairs, F});
}

void construct(Forest* self, In1<int32_t> roots, In1<int32_t> feature, In1<float> threshold,
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

Out<float> predict_pairs(const Forest& forest, In2<float> query, In2<float> site,
                         In1<int64_t> rows, In1<int64_t> columns, const LayoutRow& row,
                         int threads) {
  const PairTask task = checked_pairs(query, site, rows, columns);
  const PairLayout layout = checked_layout(row, task.dim);
  require(layout.features(task.dim) == forest.features(), "the layout does not fit the forest");
  std::vector<float> output(task.pairs);
  {
    nb::gil_scoped_release release;
    forest.predict_pairs(task, layout, threads, output.data());
  }
  return to_numpy(std::move(output));
}

nb::tuple shapes(In2<float> points, In1<int64_t> offsets, int threads) {
  check_segments(points, offsets);
  const std::size_t P = offsets.size() - 1;
  VoxelShapes result;
  {
    nb::gil_scoped_release release;
    require_usable(points.data(), points.size(), "points");
    result = voxel_shapes(points.data(), offsets.data(), P, threads);
  }
  return nb::make_tuple(to_numpy(std::move(result.voxels)), to_numpy(std::move(result.offsets)),
                        to_numpy(std::move(result.scales), {P, 3}));
}

void construct_network(VoxelNetwork* self, const TensorArrays& tensors,
                       const std::string& isa) {
  new (self) VoxelNetwork(views_of(tensors), parse_isa(isa));
}

Out<float> describe(const VoxelNetwork& network, In1<int32_t> voxels, In1<int64_t> offsets,
                    In2<float> scales, int threads) {
  check_offsets(offsets, voxels.size());
  const std::size_t P = offsets.size() - 1;
  require(scales.shape(0) == P && scales.shape(1) == 3, "scales must have shape (P, 3)");
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

}  // namespace

void bind_descriptors(nb::module_& m) {
  using namespace nb::literals;
  m.def("segment_moments", &moments, "points"_a.noconvert(), "offsets"_a.noconvert(),
        "threads"_a = 0);
  m.def("esf", &shape_functions, "points"_a.noconvert(), "offsets"_a.noconvert(),
        "triples"_a = 20'000, "seed"_a = 0, "threads"_a = 0);
  m.def("gestalt", &gestalt_, "points"_a.noconvert(), "offsets"_a.noconvert(), "radius"_a = 5.0,
        "threads"_a = 0);
  m.def("pair_features", &pair_features_, "query"_a.noconvert(), "site"_a.noconvert(),
        "rows"_a.noconvert(), "columns"_a.noconvert(), "layout"_a, "threads"_a = 0);
  nb::class_<Forest>(m, "Forest")
      .def("__init__", &construct, "roots"_a.noconvert(), "feature"_a.noconvert(),
           "threshold"_a.noconvert(), "first_child"_a.noconvert(), "features"_a)
      .def("predict", &predict, "features"_a.noconvert(), "threads"_a = 0)
      .def("predict_pairs", &predict_pairs, "query"_a.noconvert(), "site"_a.noconvert(),
           "rows"_a.noconvert(), "columns"_a.noconvert(), "layout"_a, "threads"_a = 0)
      .def_prop_ro("features", &Forest::features);
  m.def("voxel_shapes", &shapes, "points"_a.noconvert(), "offsets"_a.noconvert(),
        "threads"_a = 0);
  nb::class_<VoxelNetwork>(m, "VoxelNetwork")
      .def("__init__", &construct_network, "tensors"_a, "isa"_a = "auto")
      .def("describe", &describe, "voxels"_a.noconvert(), "offsets"_a.noconvert(),
           "scales"_a.noconvert(), "threads"_a = 0)
      .def_prop_ro("dim", &VoxelNetwork::dim);
}

}  // namespace segloc::bindings
