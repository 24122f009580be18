// Matches between places of any coordinates that a binding lets through: a finite pose or none.
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <cstdlib>
#include <cstring>
#include <stdexcept>
#include <vector>

#include "proposals/pose/consensus.h"

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  constexpr std::size_t kMatch = 6 * sizeof(float), kMost = 200;
  std::vector<double> query, map;
  std::vector<std::int64_t> index;
  for (std::size_t at = 0; at + kMatch <= size && index.size() < kMost; at += kMatch) {
    float values[6];
    std::memcpy(values, data + at, kMatch);
    for (const float v : values) {
      if (!(std::fabs(v) < 1e15f)) return 0;
    }
    query.insert(query.end(), values, values + 3);
    map.insert(map.end(), values + 3, values + 6);
    index.push_back(static_cast<std::int64_t>(index.size()));
  }
  segloc::ConsensusOptions options;
  options.max_refined = 8;
  try {
    for (const segloc::PoseHypothesis& pose :
         segloc::consensus(query.data(), index.size(), map.data(), index.data(), index.data(),
                           index.size(), options, 1)) {
      if (!std::isfinite(pose.yaw + pose.t[0] + pose.t[1] + pose.t[2])) std::abort();
    }
  } catch (const std::invalid_argument&) {
  }
  return 0;
}
