// Ensemble of shape functions (Wohlkinger and Vincze, ROBIO 2011), as PCL defines it.
#pragma once

#include <cstddef>
#include <cstdint>

namespace segloc {

constexpr std::size_t kEsfBins = 64;
constexpr std::size_t kEsfSize = 10 * kEsfBins;

// output (segments, kEsfSize). A segment is scaled to a sphere of radius 32 in a grid of 64^3
// voxels, of which those within one of a point are occupied; `triples` random triangles of its
// points give histograms of angles, of square roots of areas, of side lengths, each split by
// whether the sides run inside, outside or across the surface, and of the share of a side that is
// inside. They are weighted as in PCL and divided by their sum.
//
// Points are put in the order of their coordinates and triangles drawn by a counter: the result
// does not depend on the order of the points, nor on the number of threads. Triangles that are
// (nearly) flat are drawn again, but at most as many as are wanted: a segment without others
// gives zeros.
void esf(const float* points, const int64_t* offsets, std::size_t segments, std::size_t triples,
         uint64_t seed, int threads, float* output);

}  // namespace segloc
