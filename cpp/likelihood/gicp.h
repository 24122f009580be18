// Generalised ICP: aligns a cloud with a larger one, plane to plane.
#pragma once

#include <array>
#include <cstddef>

#include "common/rigid.h"
#include "likelihood/surface.h"

namespace segloc {

struct GicpOptions {
  std::size_t coarse = 600;        // approximate points of the first alignment
  std::size_t fine = 4000;         // and of the second
  int max_iterations = 20;         // of all points, or of the first ones
  int max_final = 6;               // of the others after those; 0: it ends with the first ones
  double translation_step = 2e-3;  // steps smaller than both of these are the last, metres
  double rotation_step = 2e-3;     // radians
};

struct GicpResult {
  Rigid T;                     // takes the source to the target
  std::array<double, 36> H{};  // curvature of half the squared error in (rotation, translation) of
                               // the source's frame, (6, 6) row-major, as of all points
  std::array<double, 36> motion{};  // the same of the squared motion of the points: H by this is
                                    // what a pair tells of a motion on average
  double error = 0.0;          // half the sum of squared errors, each in units of its deviation
  std::size_t inliers = 0;     // points that were aligned and have a correspondence
  int iterations = 0;
};

// A. Segal, D. Haehnel, S. Thrun: Generalized-ICP, RSS 2009, by Levenberg-Marquardt. Pairs are a
// point and the nearest one within the target's maximum correspondence distance. Points are
// uncertain by a metre along their surface and by a thousandth of its square across; where there is
// no normal, by a metre. The result does not depend on the number of threads.
GicpResult align(const Surface& target, const Surface& source, const Rigid& start,
                 const GicpOptions& options, int threads);

}  // namespace segloc
