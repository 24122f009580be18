// The direction of gravity in a scan, from floors, ceilings and walls.
#pragma once

#include <array>
#include <cstddef>
#include <vector>

#include "frontend/planes.h"

namespace segloc {

struct FlatOptions {
  double range = 30.0;       // metres from the sensor; more if most points are farther
  double voxel_size = 0.25;  // metres
  PlaneOptions planes;
};

// Unit normals, of either sign, of flat places around the sensor, (M, 3) row-major: of a voxel grid
// of the points within range. They do not depend on the order of the points.
std::vector<float> flat_normals(const float* points, std::size_t n, const FlatOptions& options);

// The direction that n normals are parallel or orthogonal to. It starts from the one of the `count`
// unit directions, (count, 3), that most of them agree with, and is refined by least squares once
// for each tolerance [rad].
std::array<double, 3> fit_vertical(const float* normals, std::size_t n, const double* directions,
                                   std::size_t count, const std::vector<double>& tolerances);

}  // namespace segloc
