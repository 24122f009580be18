// Quota files of any content: a number of processors, or 0 for none.
#include <cstddef>
#include <cstdint>
#include <cstdlib>
#include <string>

#include "common/processors.h"

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  const std::string text(reinterpret_cast<const char*>(data), size);
  const int processors = segloc::processors_of_quota(text.c_str());
  if (processors < 0 || processors > 4096) std::abort();
  return 0;
}
