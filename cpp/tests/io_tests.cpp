// Decompression.
#include <cstdint>
#include <random>

#include "io/lzf.h"
#include "tests/check.h"

namespace segloc {
namespace {

void decompression() {
  const std::vector<std::uint8_t> literal = {2, 'a', 'b', 'c'};
  CHECK(lzf_decompress(literal.data(), literal.size(), 3).size() == 3);
  std::mt19937 engine(5);
  for (int round = 0; round < 2000; ++round) {  // garbage is refused, and never read past its end
    std::vector<std::uint8_t> data(engine() % 40);
    for (auto& byte : data) byte = std::uint8_t(engine());
    try {
      CHECK(lzf_decompress(data.data(), data.size(), 64).size() == 64);
    } catch (const std::exception&) {
    }
  }
}

}  // namespace
}  // namespace segloc

void io_tests() { segloc::decompression(); }
