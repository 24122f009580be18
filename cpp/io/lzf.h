// Decompression of LZF, the byte-oriented Lempel-Ziv coding inside binary_compressed PCD files.
#pragma once

#include <cstddef>
#include <cstdint>
#include <vector>

namespace segloc {

// The `size` bytes that `length` bytes of LZF at `data` stand for. Throws std::invalid_argument
// where they stand for any other number of bytes or point outside of what came before them; a
// `size` that no stream of that length can reach is refused before memory is taken for it.
std::vector<std::uint8_t> lzf_decompress(const std::uint8_t* data, std::size_t length,
                                         std::size_t size);

}  // namespace segloc
