// Shape profiles: metric numbers of the size of a segment and the distribution of its points.
#pragma once

#include <cstddef>

namespace segloc {

// The first points of a segment, whose mutual distances are taken; no segment may have fewer.
constexpr std::size_t kPairedPoints = 32;

// Numbers in a profile.
std::size_t profile_size();

// output (segments, profile_size()) of prepared segments (segments, count, 3), which are centred,
// aligned and in the order of farthest-point sampling (prepare.h), and of their heights
// (segments): that of each segment's centroid above the ground. Distances enter as logarithms,
// heights as metres; descriptors/profile.py lists the numbers. Needs count >= kPairedPoints.
void shape_profiles(const float* prepared, const float* heights, std::size_t segments,
                    std::size_t count, int threads, float* output);

}  // namespace segloc
