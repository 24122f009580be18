// Segments of any size to clouds of a fixed number of points that the network reads.
#pragma once

#include <cstddef>
#include <cstdint>

#include "simd/kernels.h"

namespace segloc {

enum class Alignment { none, pca2d, pca3d };

// Segments with more points are thinned to this many before farthest-point sampling: the points
// whose coordinates have the lowest hashes, a random choice that does not depend on their order.
constexpr std::size_t kThinnedPoints = 4096;

// output (segments, count, 3): each segment centred on its mean, aligned, and reduced to `count`
// points in the order of farthest-point sampling over the whole segment. A smaller segment repeats
// its points cyclically; an empty one is all zeros.
//
// Alignment follows SegMap: pca2d turns the major horizontal axis to x, and then by 180 degrees
// where fewer than half of the points lie below the middle of the y range; pca3d turns the
// principal axes to x, y, z with the same rule on x and y (z completes a right-handed frame).
//
// Sums are taken in fixed point, which is exact: the result does not depend on the order of the
// points, equal distances aside, nor on the number of threads.
void prepare_segments(const float* points, const int64_t* offsets, std::size_t segments,
                      std::size_t count, Alignment alignment, Isa isa, int threads, float* output);

}  // namespace segloc
