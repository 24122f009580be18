#pragma once

#include <cstddef>

namespace segloc {

// Whether each value is finite and its magnitude below `limit`.
bool all_below(const float* values, std::size_t count, float limit);

}  // namespace segloc
