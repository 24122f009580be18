// Shared by the binding files: array types, checks, and moving results into NumPy.
#pragma once

#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>
#include <nanobind/stl/string.h>
#include <nanobind/stl/tuple.h>
#include <nanobind/stl/vector.h>

#include <cmath>
#include <cstdint>
#include <cstdio>
#include <limits>
#include <stdexcept>
#include <string>
#include <utility>
#include <vector>

#include "common/finite.h"

namespace segloc::bindings {

namespace nb = nanobind;

// Read-only, C-contiguous arrays on the CPU. nanobind converts nothing that is marked noconvert.
template <typename T, typename... Shape>
using In = nb::ndarray<const T, nb::c_contig, nb::device::cpu, Shape...>;
template <typename T>
using In1 = In<T, nb::ndim<1>>;
template <typename T>
using In2 = In<T, nb::ndim<2>>;
template <typename T>
using In3 = In<T, nb::ndim<3>>;
template <typename T>
using Out = nb::ndarray<nb::numpy, T>;

inline void require(bool condition, const std::string& message) {
  if (!condition) throw std::invalid_argument(message);
}

// Squares of larger values would overflow.
constexpr float kLargest = 1e15f;
// Prepared segments are centred, so they may be slightly larger than their points.
constexpr float kLargestPrepared = 1e16f;

inline void require_usable(const float* values, std::size_t count, const char* name,
                           float limit = kLargest) {
  require(all_below(values, count, limit),
          std::string(name) + " has values that are not finite or beyond 1e15");
}

inline void require_usable(const double* values, std::size_t count, const char* name) {
  bool usable = true;
  for (std::size_t i = 0; i < count; ++i) usable &= std::fabs(values[i]) < double{kLargest};
  require(usable, std::string(name) + " has values that are not finite or beyond 1e15");
}

inline std::string number_text(double value) {
  char text[32];
  std::snprintf(text, sizeof(text), "%g", value);
  return text;
}

// NaN has no position.
inline void require_between(double value, double low, double high, const char* name) {
  require(value >= low && value <= high, std::string(name) + " must be from " + number_text(low) +
                                             " to " + number_text(high) + ", not " +
                                             number_text(value));
}

// Limits of radii, edges and tolerances [m].
constexpr double kShortest = 1e-6, kLongest = 1e9;
inline void require_length(double metres, const char* name) {
  require_between(metres, kShortest, kLongest, name);
}

// Numbers of columns: whatever is multiplied with them stays far below the largest size.
constexpr std::size_t kMostColumns = std::size_t{1} << 20;
inline void require_columns(std::size_t columns, const char* name) {
  require(columns <= kMostColumns, std::string(name) + " has too many columns");
}

inline void require_points(const In2<float>& points, const char* name = "points") {
  require(points.shape(1) == 3, std::string(name) + " must have shape (N, 3)");
  // Their places are numbered in 32 bits.
  require(points.shape(0) <= std::numeric_limits<std::uint32_t>::max(),
          std::string(name) + " has too many rows");
}

// A matrix (4, 4) of finite values; its last row is not read.
inline void require_transform(const In2<double>& T, const char* name) {
  require(T.shape(0) == 4 && T.shape(1) == 4, std::string(name) + " must have shape (4, 4)");
  require_usable(T.data(), T.size(), name);
}

inline void check_offsets(const In1<int64_t>& offsets, std::size_t points) {
  require(offsets.size() > 0 && offsets.data()[0] == 0, "offsets must start with 0");
  for (std::size_t i = 1; i < offsets.size(); ++i) {
    require(offsets.data()[i] >= offsets.data()[i - 1], "offsets must not fall");
  }
  require(offsets.data()[offsets.size() - 1] == static_cast<int64_t>(points),
          "offsets must end with the number of points");
}

inline void check_segments(const In2<float>& points, const In1<int64_t>& offsets) {
  require(points.shape(1) == 3, "points must have shape (M, 3)");
  require(points.shape(0) < (std::size_t{1} << 31), "too many points");
  check_offsets(offsets, points.shape(0));
}

// Hands a vector's memory to NumPy without copying it.
template <typename T>
Out<T> to_numpy(std::vector<T>&& values, std::vector<std::size_t> shape) {
  auto* owned = new std::vector<T>(std::move(values));
  nb::capsule owner(owned, [](void* p) noexcept { delete static_cast<std::vector<T>*>(p); });
  return Out<T>(owned->data(), shape.size(), shape.data(), owner);
}

template <typename T>
Out<T> to_numpy(std::vector<T>&& values) {
  const std::size_t size = values.size();
  return to_numpy(std::move(values), {size});
}

}  // namespace segloc::bindings
