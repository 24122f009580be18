// Preparation of segments, and descriptors made by hand.
#include "bindings/bindings.h"
#include "descriptors/esf.h"
#include "descriptors/fps.h"
#include "descriptors/gestalt.h"
#include "descriptors/moments.h"
#include "descriptors/prepare.h"
#include "descriptors/profile.h"
#include "descriptors/voxel_shape.h"

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
  require_length(radius, "radius");
  const std::size_t P = offsets.size() - 1;
  std::vector<float> output(P * kGestaltSize);
  {
    nb::gil_scoped_release release;
    require_usable(points.data(), points.size(), "points");
    gestalt(points.data(), offsets.data(), P, radius, threads, output.data());
  }
  return to_numpy(std::move(output), {P, kGestaltSize});
}

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

constexpr std::size_t kMostPrepared = 65535;  // points, so that no sum of squares overflows

Out<float> profiles(In3<float> prepared, In1<float> heights, int threads) {
  const std::size_t P = prepared.shape(0), N = prepared.shape(1);
  require(prepared.shape(2) == 3, "prepared must have shape (P, N, 3)");
  require(N >= kPairedPoints,
          "prepared segments need at least " + std::to_string(kPairedPoints) + " points");
  require(N <= kMostPrepared,
          "prepared segments have at most " + std::to_string(kMostPrepared) + " points");
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

}  // namespace

void bind_descriptors(nb::module_& m) {
  using namespace nb::literals;
  m.def("segment_moments", &moments, "points"_a.noconvert(), "offsets"_a.noconvert(),
        "threads"_a = 0);
  m.def("esf", &shape_functions, "points"_a.noconvert(), "offsets"_a.noconvert(),
        "triples"_a = 20'000, "seed"_a = 0, "threads"_a = 0);
  m.def("gestalt", &gestalt_, "points"_a.noconvert(), "offsets"_a.noconvert(), "radius"_a = 5.0,
        "threads"_a = 0);
  m.def("fps", &fps, "points"_a.noconvert(), "samples"_a, "threads"_a = 0, "isa"_a = "auto");
  m.def("prepare_segments", &prepare, "points"_a.noconvert(), "offsets"_a.noconvert(),
        "count"_a = 256, "alignment"_a = "pca2d", "threads"_a = 0, "isa"_a = "auto");
  m.def("voxel_shapes", &shapes, "points"_a.noconvert(), "offsets"_a.noconvert(), "threads"_a = 0);
  m.def("shape_profiles", &profiles, "prepared"_a.noconvert(), "heights"_a.noconvert(),
        "threads"_a = 0);
}

}  // namespace segloc::bindings
