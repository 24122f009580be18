// What C++17 has no names for.
#pragma once

namespace segloc {

constexpr double kPi = 3.14159265358979323846;
constexpr double kDegrees = 180.0 / kPi;  // of a radian

}  // namespace segloc
