// Matches in the order of their scores.
#pragma once

#include <cstddef>
#include <cstdint>
#include <vector>

namespace segloc {

// Which of `n` matches comes first, second, ...: those of a higher score first, among equal ones
// those of the lower query and then of the lower map segment. Scores are not NaN.
std::vector<int64_t> order_matches(const int64_t* query, const int64_t* map, const float* score,
                                   std::size_t n);

}  // namespace segloc
