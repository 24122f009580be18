#include "io/lzf.h"

#include <cstring>
#include <stdexcept>

namespace segloc {

// A stream is a row of two kinds of token, told apart by the three high bits of the first byte:
//   000lllll                           l + 1 literal bytes follow
//   lllooooo oooooooo                  copy l + 2 bytes from o + 1 bytes back (l in 1..6)
//   111ooooo llllllll oooooooo         copy l + 9 bytes from o + 1 bytes back
std::vector<std::uint8_t> lzf_decompress(const std::uint8_t* data, std::size_t length,
                                         std::size_t size) {
  constexpr std::size_t kLongestCopy = 264, kBytesOfLongestCopy = 3;
  if (size / kLongestCopy > length / kBytesOfLongestCopy + 1)
    throw std::invalid_argument("the compressed data is too short for its size");

  const auto require = [](bool condition) {
    if (!condition) throw std::invalid_argument("the compressed data is corrupt");
  };
  std::vector<std::uint8_t> out(size);
  std::size_t in = 0, at = 0;
  while (in < length) {
    const std::size_t control = data[in++];
    if (control < 32) {
      const std::size_t run = control + 1;
      require(run <= length - in && run <= size - at);
      std::memcpy(out.data() + at, data + in, run);
      in += run;
      at += run;
      continue;
    }
    std::size_t run = (control >> 5) + 2;
    if (run == 9) {
      require(in < length);
      run += data[in++];
    }
    require(in < length);
    const std::size_t back = ((control & 31) << 8) + data[in++] + 1;
    require(back <= at && run <= size - at);
    // Byte by byte: a copy may overlap what it writes, which is how a run repeats.
    for (std::size_t end = at + run; at < end; ++at) out[at] = out[at - back];
  }
  require(at == size);
  return out;
}

}  // namespace segloc
