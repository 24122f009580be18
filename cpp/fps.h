// Farthest-point sampling of many small clouds.
#pragma once

#include <cstddef>
#include <cstdint>

#include "aligned.h"
#include "kernels.h"

namespace segloc {

// Scratch memory for clouds of up to `capacity` points.
class FpsScratch {
 public:
  explicit FpsScratch(std::size_t capacity);
  FpsCloud cloud(int32_t* order);

 private:
  std::size_t padded_;
  AlignedFloats memory_;
};

// order (clouds, samples): for each of the clouds (clouds, n, 3), indices in the order in which
// farthest-point sampling takes its points. It starts at the point farthest from the centroid; each
// further one is the farthest from those taken so far, the lowest index among equals. No index is
// taken twice. The same on every instruction set and for any number of threads.
void farthest_points(const float* points, std::size_t clouds, std::size_t n, std::size_t samples,
                     Isa isa, int threads, int32_t* order);

}  // namespace segloc
