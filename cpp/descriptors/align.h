// Alignment of a segment with its own frame.
#pragma once

#include <cstddef>
#include <vector>

namespace segloc {

// Both take n points (n, 3) centred on their mean and turn them in place. Their result does not
// depend on the order of the points. The rule for signs is SegMap's: at least half of the points
// lie below the middle of the range.

// The major horizontal axis to x; the rule on y.
void align_2d(std::vector<float>& points, std::size_t n);

// The principal axes to x, y, z; the rule on x and y, and z completes a right-handed frame.
void align_3d(std::vector<float>& points, std::size_t n);

}  // namespace segloc
