// Descriptors of a map, as numbers or as the integers of a lattice.
#pragma once

#include <cstddef>
#include <cstdint>
#include <vector>

namespace segloc {

// Rows of (count, dim). They must stay where they are.
struct DescriptorRows {
  DescriptorRows(const float* rows, std::size_t n, std::size_t columns)
      : values(rows), count(n), dim(columns) {}
  // Value d of a row is base[d] + code * step[d], which is exact in single precision.
  DescriptorRows(const std::uint8_t* rows, const float* bases, const float* steps, std::size_t n,
                 std::size_t columns)
      : codes(rows), base(bases), step(steps), count(n), dim(columns) {}

  // `n` rows from one on, in `buffer` if they are coded.
  const float* read(std::size_t first, std::size_t n, std::vector<float>& buffer) const {
    if (values) return values + first * dim;
    buffer.resize(n * dim);
    for (std::size_t i = 0; i < n; ++i) decode(first + i, buffer.data() + i * dim);
    return buffer.data();
  }
  void decode(std::size_t i, float* row) const {
    const std::uint8_t* coded = codes + i * dim;
    for (std::size_t d = 0; d < dim; ++d) {
      row[d] = base[d] + static_cast<float>(coded[d]) * step[d];
    }
  }

  const float* values = nullptr;
  const std::uint8_t* codes = nullptr;
  const float *base = nullptr, *step = nullptr;
  std::size_t count, dim;
};

}  // namespace segloc
