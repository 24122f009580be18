// Hashes of what kernels answer, bit by bit: `kernel_tests --digests` prints them, to be compared
// between processors. Of kernels that exist for several instruction sets, the portable answer.
#pragma once

#include <cstdint>
#include <cstdio>
#include <cstring>
#include <map>
#include <string>

#include "simd/kernels.h"

namespace segloc {

inline std::map<std::string, std::uint64_t>& digests() {
  static std::map<std::string, std::uint64_t> all;
  return all;
}

// FNV-1a, going on from the results of that name before.
template <typename Values>
void digest(const char* name, const Values& values) {
  std::uint64_t& hash = digests().try_emplace(name, 0xcbf29ce484222325u).first->second;
  for (const auto& value : values) {
    unsigned char bytes[sizeof(value)];
    std::memcpy(bytes, &value, sizeof(value));
    for (const unsigned char byte : bytes) hash = (hash ^ byte) * 0x100000001b3u;
  }
}

template <typename Values>
void digest(Isa isa, const char* name, const Values& values) {
  if (isa == Isa::portable) digest(name, values);
}

inline void print_digests() {
  for (const auto& [name, hash] : digests()) {
    std::printf("%-16s %016llx\n", name.c_str(), static_cast<unsigned long long>(hash));
  }
}

}  // namespace segloc
