// Decompression and octrees.
#include <cstdint>
#include <random>

#include "io/lzf.h"
#include "io/octree.h"
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

const VoxelGrid kGrid{{-4, 0, 7}, {0.1, 0.2, 0.3}, 0.3, 0};

void octrees() {
  std::mt19937 engine(6);
  for (int levels = 1; levels <= kMostOctreeLevels; ++levels) {
    for (std::size_t count : {0, 1, 5, 60}) {
      std::vector<std::int32_t> cells(3 * count);
      for (auto& cell : cells) cell = std::int32_t(engine() % (1U << levels));
      const auto codes = octree_encode(cells.data(), count, levels);
      std::size_t distinct = 0;  // as many as there are
      while (distinct <= count) {
        try {
          const auto points =
              octree_points(codes.data(), codes.size(), levels, distinct, nullptr, kGrid);
          CHECK(points.size() == 3 * distinct);
          break;
        } catch (const std::invalid_argument&) {
          ++distinct;
        }
      }
      CHECK(distinct <= count && (distinct > 0) == (count > 0));
    }
  }
  for (int round = 0; round < 2000; ++round) {  // garbage is refused, and never read past its end
    std::vector<std::uint8_t> codes(engine() % 40);
    for (auto& byte : codes) byte = std::uint8_t(engine());
    try {
      octree_points(codes.data(), codes.size(), 1 + int(engine() % 30), engine() % 100, nullptr,
                    kGrid);
    } catch (const std::invalid_argument&) {
    }
  }
}

}  // namespace
}  // namespace segloc

void io_tests() {
  segloc::decompression();
  segloc::octrees();
}
