// Gestalt descriptor (Bosse and Zlot, ICRA 2013), of whole segments.
#pragma once

#include <cstddef>
#include <cstdint>

namespace segloc {

constexpr std::size_t kGestaltRings = 4, kGestaltSectors = 8;
constexpr std::size_t kGestaltBins = kGestaltRings * kGestaltSectors;
constexpr std::size_t kGestaltSize = 2 * kGestaltBins + 2;

// output (segments, kGestaltSize): mean height of the points in each bin, rings from the inside and
// sectors counterclockwise, relative to the key point; the variance of the height likewise; then
// planarity 2 (l2 - l1) / sum and cylindricality (l3 - l2) / sum of the rising eigenvalues.
//
// The key point is the segment's mean. Its frame stands upright with x along the minor horizontal
// axis, where a surface's normal points, on the side that SegMap's rule chooses. An empty bin takes
// the values of the next ring inwards; points beyond `radius` are left out.
void gestalt(const float* points, const int64_t* offsets, std::size_t segments, double radius,
             int threads, float* output);

}  // namespace segloc
