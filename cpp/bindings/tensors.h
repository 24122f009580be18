// Named tensors of a network from Python.
#pragma once

#include <nanobind/stl/map.h>

#include <map>
#include <string>
#include <utility>

#include "bindings/bindings.h"
#include "descriptors/network/network.h"

namespace segloc::bindings {

using TensorArrays = std::map<std::string, In<float>>;

// Views that are valid for as long as the arrays. Throws if a value is not finite.
inline Tensors views_of(const TensorArrays& tensors) {
  Tensors views;
  for (const auto& [name, array] : tensors) {
    require_usable(array.data(), array.size(), ("tensor '" + name + "'").c_str());
    TensorView view{array.data(), {}};
    for (std::size_t i = 0; i < array.ndim(); ++i) view.shape.push_back(array.shape(i));
    views.emplace(name, std::move(view));
  }
  return views;
}

}  // namespace segloc::bindings
