// LZF streams of any content; the first two bytes are the requested size.
#include <cstddef>
#include <cstdint>
#include <cstdlib>
#include <stdexcept>

#include "io/lzf.h"

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  if (size < 2) return 0;
  const std::size_t size_out = data[0] | std::size_t{data[1]} << 8;
  try {
    if (segloc::lzf_decompress(data + 2, size - 2, size_out).size() != size_out) std::abort();
  } catch (const std::invalid_argument&) {
  }
  return 0;
}
