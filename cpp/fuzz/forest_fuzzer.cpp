// Forests of any content: refused, or every descent ends and the answer is finite.
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <cstdlib>
#include <cstring>
#include <stdexcept>
#include <vector>

#include "proposals/matching/random_forest.h"

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  constexpr std::size_t kFeatures = 4, kNode = 12;
  std::vector<std::int32_t> feature, first_child;
  std::vector<float> threshold;
  if (size < 4) return 0;
  std::int32_t root;
  std::memcpy(&root, data, 4);
  for (std::size_t at = 4; at + kNode <= size; at += kNode) {
    std::int32_t node[2];
    float value;
    std::memcpy(node, data + at, 8);
    std::memcpy(&value, data + at + 8, 4);
    feature.push_back(node[0]);
    first_child.push_back(node[1]);
    threshold.push_back(value);
  }
  try {
    const segloc::Forest forest(
        {&root, 1, feature.data(), threshold.data(), first_child.data(), feature.size()},
        kFeatures);
    const float input[3 * kFeatures] = {0, 1, -1, 1e30f, -1e30f, 0.5f, NAN, INFINITY, 2, 3, 4, 5};
    float output[3];
    forest.predict(input, 3, 1, output);
    for (const float value : output) {
      if (!std::isfinite(value)) std::abort();
    }
  } catch (const std::invalid_argument&) {
  }
  return 0;
}
