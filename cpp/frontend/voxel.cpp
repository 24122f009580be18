#include "frontend/voxel.h"

#include "common/cells.h"

namespace segloc {

std::vector<float> voxel_grid(const float* points, std::size_t n, double size) {
  const CellOrder cells = sort_into_cells(points, n, size);
  std::vector<float> means;
  means.reserve(n);
  for (std::size_t begin = 0; begin < n;) {
    double sum[3] = {0.0, 0.0, 0.0};
    std::size_t end = begin;
    for (; end < n && cells.keys[end] == cells.keys[begin]; ++end) {
      const float* p = points + 3 * static_cast<std::size_t>(cells.order[end]);
      for (int a = 0; a < 3; ++a) sum[a] += p[a];
    }
    for (int a = 0; a < 3; ++a) means.push_back(static_cast<float>(sum[a] / double(end - begin)));
    begin = end;
  }
  return means;
}

}  // namespace segloc
