#include "common/finite.h"

#include "simd/kernels.h"

namespace segloc {

bool all_below(const float* values, std::size_t count, float limit) {
  return best_kernels().all_below(values, count, limit);
}

}  // namespace segloc
