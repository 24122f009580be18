#include "common/eigen_axes.h"

#include <algorithm>
#include <cmath>

namespace segloc {

EigenAxes eigen_axes(Mat3 a) {
  Mat3 v = {{{1, 0, 0}, {0, 1, 0}, {0, 0, 1}}};  // rows
  for (int sweep = 0; sweep < 32; ++sweep) {
    const double off = std::abs(a[0][1]) + std::abs(a[0][2]) + std::abs(a[1][2]);
    if (off <= 1e-15 * (a[0][0] + a[1][1] + a[2][2])) break;
    for (std::size_t p = 0; p < 2; ++p) {
      for (std::size_t q = p + 1; q < 3; ++q) {
        if (a[p][q] == 0) continue;
        const double angle = 0.5 * std::atan2(2 * a[p][q], a[q][q] - a[p][p]);
        const double c = std::cos(angle), s = std::sin(angle);
        for (std::size_t i = 0; i < 3; ++i) {
          const double x = a[i][p], y = a[i][q];
          a[i][p] = c * x - s * y;
          a[i][q] = s * x + c * y;
        }
        for (std::size_t i = 0; i < 3; ++i) {
          const double x = a[p][i], y = a[q][i], vx = v[p][i], vy = v[q][i];
          a[p][i] = c * x - s * y;
          a[q][i] = s * x + c * y;
          v[p][i] = c * vx - s * vy;
          v[q][i] = s * vx + c * vy;
        }
      }
    }
  }
  std::array<std::size_t, 3> order = {0, 1, 2};
  std::stable_sort(order.begin(), order.end(),
                   [&](std::size_t i, std::size_t j) { return a[i][i] > a[j][j]; });
  EigenAxes result;
  for (std::size_t d = 0; d < 3; ++d) {
    result.axes[d] = v[order[d]];
    result.values[d] = a[order[d]][order[d]];
  }
  return result;
}

}  // namespace segloc
