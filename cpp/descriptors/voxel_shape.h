// Segments as small occupancy grids (SegMap, RSS 2018).
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <vector>

namespace segloc {

// The grid of a segment; voxel (x, y, z) is number (x * kShapeSize[1] + y) * kShapeSize[2] + z.
constexpr std::array<std::size_t, 3> kShapeSize = {32, 32, 16};
constexpr std::size_t kShapeVoxels = kShapeSize[0] * kShapeSize[1] * kShapeSize[2];
constexpr double kLeastVoxel = 0.1;  // metres

struct VoxelShapes {
  std::vector<int32_t> voxels;   // of all segments, each segment's rising
  std::vector<int64_t> offsets;  // (segments + 1)
  std::vector<float> scales;     // (segments, 3): metres that the grid spans
};

// Each segment is aligned as by align_2d, divided by its extent along each axis (or by what the
// least voxel size allows, if that is more), and centred on its mean; what then lies outside the
// grid is left out. Does not depend on the order of the points.
VoxelShapes voxel_shapes(const float* points, const int64_t* offsets, std::size_t segments,
                         int threads);

}  // namespace segloc
