// The little that these tests need of a framework.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <cstdio>
#include <cstdlib>
#include <random>
#include <stdexcept>
#include <vector>

#include "simd/kernels.h"
#include "tests/digests.h"

#define CHECK(condition)                                                                 \
  do {                                                                                   \
    if (!(condition)) {                                                                  \
      std::fprintf(stderr, "%s:%d: %s does not hold\n", __FILE__, __LINE__, #condition); \
      std::exit(1);                                                                      \
    }                                                                                    \
  } while (false)

#define CHECK_THROWS(expression)      \
  do {                                \
    bool thrown = false;              \
    try {                             \
      (void)(expression);             \
    } catch (const std::exception&) { \
      thrown = true;                  \
    }                                 \
    CHECK(thrown);                    \
  } while (false)

inline std::vector<float> random_floats(std::size_t n, float low, float high, unsigned seed) {
  std::mt19937 engine(seed);
  std::uniform_real_distribution<float> uniform(low, high);
  std::vector<float> values(n);
  for (float& v : values) v = uniform(engine);
  return values;
}

// The instruction sets that this machine has.
inline std::vector<segloc::Isa> instruction_sets() {
  std::vector<segloc::Isa> found;
  for (const char* name : segloc::kIsaNames) {
    try {
      found.push_back(segloc::parse_isa(name));
    } catch (const std::invalid_argument&) {
    }
  }
  return found;
}

inline bool all_finite(const std::vector<float>& values) {
  return std::all_of(values.begin(), values.end(), [](float v) { return std::isfinite(v); });
}

// Sizes of clouds: nothing, little, and around multiples of vectors.
inline const std::vector<std::size_t> kSizes = {0, 1, 2, 3, 17, 255, 256, 257, 4000};
