#include "proposals/matching/match_order.h"

#include <algorithm>
#include <cstring>
#include <numeric>
#include <utility>

#include "common/cells.h"

namespace segloc {
namespace {

// Falls as the score rises; scores that compare equal have the same key.
std::uint32_t falling_key(float score) {
  const float value = score + 0.0f;  // -0 becomes 0
  std::uint32_t bits;
  std::memcpy(&bits, &value, sizeof(bits));
  return (bits >> 31) != 0 ? bits : ~bits & 0x7fffffffu;
}

}  // namespace

std::vector<int64_t> order_matches(const int64_t* query, const int64_t* map, const float* score,
                                   std::size_t n) {
  std::vector<std::uint64_t> keys(n);
  std::vector<std::uint32_t> order(n);
  for (std::size_t k = 0; k < n; ++k) keys[k] = falling_key(score[k]);
  std::iota(order.begin(), order.end(), 0u);
  radix_sort(keys, order, 32);
  const auto before = [&](std::uint32_t a, std::uint32_t b) {
    return std::make_pair(query[a], map[a]) < std::make_pair(query[b], map[b]);
  };
  for (std::size_t begin = 0; begin < n;) {
    std::size_t end = begin + 1;
    while (end < n && keys[end] == keys[begin]) ++end;
    const auto first = order.begin();
    if (end - begin > 1) {
      std::sort(first + static_cast<std::ptrdiff_t>(begin),
                first + static_cast<std::ptrdiff_t>(end), before);
    }
    begin = end;
  }
  return {order.begin(), order.end()};
}

}  // namespace segloc
