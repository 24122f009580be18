// What is occupied around places, by distance, height and direction.
#pragma once

#include <cstddef>
#include <cstdint>
#include <vector>

namespace segloc {

struct PolarGrid {
  double ring_m;     // width of a ring
  int rings, bands;  // bands of 8 / bands height slices each
  int sectors;       // even; the first begins at the x axis, and they go on to the y axis
};

// 1 where a cell of (n, 2), with its occupied height slices as bits, lies in a part of the image
// around one of (p, 2) places, and else 0: (p, rings, bands, sectors). Threads do not change it.
std::vector<std::uint8_t> polar_images(const float* cells, const std::uint8_t* slices,
                                       std::size_t n, const float* places, std::size_t p,
                                       const PolarGrid& grid, int threads);

}  // namespace segloc
