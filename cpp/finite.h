#pragma once

#include <cstddef>

namespace segloc {

// Whether no value is NaN or infinite.
bool all_finite(const float* values, std::size_t count);

}  // namespace segloc
