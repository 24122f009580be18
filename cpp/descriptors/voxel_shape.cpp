#include "descriptors/voxel_shape.h"

#include <algorithm>
#include <cmath>

#include "common/parallel.h"
#include "descriptors/align.h"
#include "descriptors/moments.h"

namespace segloc {
namespace {

std::array<double, 3> grid_extent(const std::vector<float>& p, std::size_t n) {
  std::array<double, 3> extent;
  for (std::size_t d = 0; d < 3; ++d) {
    float low = p[d], high = p[d];
    for (std::size_t i = 0; i < n; ++i) {
      low = std::min(low, p[3 * i + d]);
      high = std::max(high, p[3 * i + d]);
    }
    const double least = kLeastVoxel * static_cast<double>(kShapeSize[d]);
    extent[d] = std::max(double{high} - double{low}, least);
  }
  return extent;
}

void add_voxels(const float* points, std::size_t n, std::vector<float>& centred, float* scales,
                std::vector<int32_t>& voxels) {
  centre_points(points, n, centred);
  align_2d(centred, n);
  const std::array<double, 3> extent = grid_extent(centred, n);
  for (std::size_t d = 0; d < 3; ++d) scales[d] = static_cast<float>(extent[d]);
  for (std::size_t i = 0; i < n; ++i) {
    std::size_t number = 0;
    bool inside = true;
    for (std::size_t d = 0; d < 3; ++d) {
      const auto size = static_cast<double>(kShapeSize[d]);
      const double v = std::floor(centred[3 * i + d] / extent[d] * size + size / 2);
      inside &= v >= 0 && v < size;
      number = number * kShapeSize[d] + static_cast<std::size_t>(inside ? v : 0.0);
    }
    if (inside) voxels.push_back(static_cast<int32_t>(number));
  }
  std::sort(voxels.begin(), voxels.end());
  voxels.erase(std::unique(voxels.begin(), voxels.end()), voxels.end());
}

}  // namespace

VoxelShapes voxel_shapes(const float* points, const int64_t* offsets, std::size_t segments,
                         int threads) {
  std::vector<std::vector<int32_t>> parts(segments);
  VoxelShapes shapes;
  shapes.scales.assign(3 * segments, 0.0f);
  parallel_for(segments, 8, threads, [&](std::size_t begin, std::size_t end, int) {
    std::vector<float> centred;
    for (std::size_t s = begin; s < end; ++s) {
      const auto n = static_cast<std::size_t>(offsets[s + 1] - offsets[s]);
      if (n == 0) continue;
      add_voxels(points + 3 * offsets[s], n, centred, shapes.scales.data() + 3 * s, parts[s]);
    }
  });
  shapes.offsets.push_back(0);
  for (const std::vector<int32_t>& part : parts) {
    shapes.voxels.insert(shapes.voxels.end(), part.begin(), part.end());
    shapes.offsets.push_back(static_cast<int64_t>(shapes.voxels.size()));
  }
  return shapes;
}

}  // namespace segloc
