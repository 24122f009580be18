#include "common/finite.h"

#include <cstdint>
#include <cstring>

namespace segloc {

bool all_below(const float* values, std::size_t count, float limit) {
  uint32_t limit_bits;
  std::memcpy(&limit_bits, &limit, sizeof(limit_bits));
  uint32_t faults = 0;  // no early exit: the loop becomes vector instructions
  for (std::size_t i = 0; i < count; ++i) {
    uint32_t bits;
    std::memcpy(&bits, values + i, sizeof(bits));
    faults += (bits & 0x7fffffff) >= limit_bits;  // NaN and infinity have the largest bits
  }
  return faults == 0;
}

}  // namespace segloc
