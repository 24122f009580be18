#include "descriptors/network/neighbors.h"

#include <limits>
#include <vector>

#include "common/aligned.h"
#include "common/parallel.h"

namespace segloc {

void dilated_neighbors(const float* points, std::size_t clouds, std::size_t n, std::size_t sources,
                       std::size_t queries, int neighbors, int dilation, Isa isa, int threads,
                       int64_t* result) {
  const Kernels& k = kernels(isa);
  const std::size_t stride = padded(sources, 16);
  const std::size_t size = queries * static_cast<std::size_t>(neighbors);
  parallel_for(clouds, 8, threads, [&](std::size_t begin, std::size_t end, int) {
    AlignedFloats xyz(3 * stride), scratch(neighbor_scratch_size(sources));
    std::fill(xyz.data(), xyz.data() + 3 * stride, std::numeric_limits<float>::infinity());
    std::vector<uint16_t> indices(size);
    for (std::size_t c = begin; c < end; ++c) {
      const float* p = points + c * n * 3;
      for (std::size_t i = 0; i < sources; ++i) {
        for (std::size_t d = 0; d < 3; ++d) xyz[d * stride + i] = p[3 * i + d];
      }
      k.neighbors({xyz.data(), xyz.data() + stride, xyz.data() + 2 * stride, sources, queries,
                   neighbors, dilation, scratch.data(), indices.data()});
      std::copy(indices.begin(), indices.end(), result + c * size);
    }
  });
}

}  // namespace segloc
