// The little that these tests need of a framework.
#pragma once

#include <cstdint>
#include <cstdio>
#include <cstdlib>
#include <random>
#include <vector>

#define CHECK(condition)                                                            \
  do {                                                                              \
    if (!(condition)) {                                                             \
      std::fprintf(stderr, "%s:%d: %s does not hold\n", __FILE__, __LINE__, #condition); \
      std::exit(1);                                                                 \
    }                                                                               \
  } while (false)

#define CHECK_THROWS(expression)                 \
  do {                                           \
    bool thrown = false;                         \
    try {                                        \
      (void)(expression);                        \
    } catch (const std::exception&) {            \
      thrown = true;                             \
    }                                            \
    CHECK(thrown);                               \
  } while (false)

inline std::vector<float> random_floats(std::size_t n, float low, float high, unsigned seed) {
  std::mt19937 engine(seed);
  std::uniform_real_distribution<float> uniform(low, high);
  std::vector<float> values(n);
  for (float& v : values) v = uniform(engine);
  return values;
}

void descriptor_tests();
void geometry_tests();
void network_tests();
