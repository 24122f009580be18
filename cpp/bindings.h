// Shared by the binding files: array types, checks, and moving results into NumPy.
#pragma once

#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>
#include <nanobind/stl/string.h>
#include <nanobind/stl/tuple.h>
#include <nanobind/stl/vector.h>

#include <cmath>
#include <cstdint>
#include <stdexcept>
#include <string>
#include <utility>
#include <vector>

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
