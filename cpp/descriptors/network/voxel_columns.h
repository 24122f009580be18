// The grids inside the voxel network, column by column: z and then the channels are innermost.
#pragma once

#include <array>
#include <cstddef>

#include "descriptors/voxel_shape.h"

namespace segloc {

// The grids after one and after two poolings, and with a border of zeros.
constexpr std::size_t kX1 = kShapeSize[0] / 2, kY1 = kShapeSize[1] / 2, kZ1 = kShapeSize[2] / 2;
constexpr std::size_t kX2 = kX1 / 2, kY2 = kY1 / 2, kZ2 = kZ1 / 2;
constexpr std::size_t kCells2 = kX2 * kY2 * kZ2;

inline std::size_t padded_column(std::size_t x, std::size_t y, std::size_t columns,
                                 std::size_t depth) {
  return (x * (columns + 2) + y) * (depth + 2);
}

// Which columns of a grid with a border differ from those of the empty grid.
template <std::size_t X, std::size_t Y>
using Active = std::array<std::array<bool, Y + 2>, X + 2>;

// The columns around one that differ, as pieces of a convolution.
struct Pieces {
  std::size_t count = 0;
  std::array<std::size_t, 9> offset, weight_row;

  void add(std::size_t dx, std::size_t dy, std::size_t columns, std::size_t depth,
           std::size_t channels) {
    offset[count] = padded_column(dx, dy, columns, depth) * channels;
    weight_row[count++] = (3 * dx + dy) * 3 * channels;
  }
};

}  // namespace segloc
