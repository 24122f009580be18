// Sampling, preparation and hand-made descriptors, on odd segments.
#include <cmath>
#include <cstdint>
#include <cstring>
#include <utility>

#include "descriptors/esf.h"
#include "descriptors/fps.h"
#include "descriptors/gestalt.h"
#include "descriptors/moments.h"
#include "descriptors/prepare.h"
#include "descriptors/profile.h"
#include "tests/check.h"

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
    digest("moments", values);
    digest("esf", shape);
    digest("gestalt", rings);
  }
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
      digest("profile", one);
    }
  }
}

// Statistics of clouds side by side are the same on all instruction sets, bit by bit.
void lanes_agree(Isa isa) {
  const Kernels &k = kernels(isa), &portable = kernels(Isa::portable);
  constexpr std::size_t kCount = 33;
  const auto rows = random_floats(3 * kCount * kSortLanes, -4.0f, 4.0f, 9);
  const float* const xyz[] = {rows.data(), rows.data() + kCount * kSortLanes,
                              rows.data() + 2 * kCount * kSortLanes};
  AxisLanes axes[3], expected[3];
  for (std::size_t d = 0; d < 3; ++d) {
    k.axis_statistics(xyz[d], kCount, axes[d]);
    portable.axis_statistics(xyz[d], kCount, expected[d]);
  }
  CHECK(std::memcmp(axes, expected, sizeof(axes)) == 0);
  const std::vector<float> span(kSortLanes, 8.0f);
  const SliceTask task = {
      xyz[2], {xyz[0], xyz[1]}, axes[2].low, span.data(), {axes[0].mean, axes[1].mean}, kCount, 8};
  std::vector<float> numbers(kCount * kSortLanes);
  SliceLanes sums[8], expected_sums[8];
  k.slice_sums(task, numbers.data(), sums);
  portable.slice_sums(task, numbers.data(), expected_sums);
  CHECK(std::memcmp(sums, expected_sums, sizeof(sums)) == 0);
  constexpr std::size_t kPairs = kCount * (kCount - 1) / 2 * kSortLanes;
  std::vector<float> pairs(3 * kPairs), expected_pairs(3 * kPairs);
  for (const auto& [kernel, to] : {std::pair{&k, &pairs}, std::pair{&portable, &expected_pairs}}) {
    float* p = to->data();
    kernel->pair_distances(xyz, kCount, p, p + kPairs, p + 2 * kPairs);
  }
  CHECK(pairs == expected_pairs);
}

void sampling(Isa isa) {
  for (const std::size_t n : {1, 5, 63, 64, 65, 256, 300, 700}) {
    const auto points = random_floats(3 * 4 * n, -3.0f, 3.0f, 7);
    std::vector<int32_t> order(4 * n), portable(4 * n);
    farthest_points(points.data(), 4, n, n, isa, 2, order.data());
    farthest_points(points.data(), 4, n, n, Isa::portable, 1, portable.data());
    CHECK(order == portable);
    digest(isa, "fps", order);
  }
  const std::vector<int64_t> offsets = {0, 0, 1, 4, 300, 6000};
  const auto points = random_floats(3 * 6000, -5.0f, 5.0f, 8);
  for (const Alignment alignment : {Alignment::none, Alignment::pca2d, Alignment::pca3d}) {
    std::vector<float> out(5 * 256 * 3, NAN);
    prepare_segments(points.data(), offsets.data(), 5, 256, alignment, isa, 2, out.data());
    CHECK(all_finite(out));
    digest(isa, "prepare", out);
  }
}

}  // namespace
}  // namespace segloc

void descriptors_tests() {
  segloc::hand_made();
  segloc::profiles();
  for (const segloc::Isa isa : instruction_sets()) {
    segloc::lanes_agree(isa);
    segloc::sampling(isa);
  }
}
