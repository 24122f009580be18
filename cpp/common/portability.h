// What C++17 has no words for. Nothing else in the library is written for one compiler: this header
// and the vector operators in simd/simd.h need GCC or Clang.
//
// Everything is static: a shared definition could come from a file that was built for a newer
// processor (simd/simd.h).
#pragma once

#include <cstddef>
#include <cstdint>

// Loops over registers must be unrolled completely, or their arrays live in memory.
#define SEGLOC_UNROLL _Pragma("GCC unroll 16")

// a, value by value, as a vector of another type.
#define SEGLOC_CONVERT(a, Type) __builtin_convertvector(a, Type)

// A vector type of so many bytes, with operators for each of its values.
#define SEGLOC_VECTOR(type, name, bytes) typedef type name __attribute__((vector_size(bytes)))

// Whether this processor has a feature, as "avx2".
#define SEGLOC_CPU_HAS(feature) (__builtin_cpu_init(), __builtin_cpu_supports(feature) != 0)

namespace segloc {

static constexpr float kInfinity = __builtin_inff();

// The number of zeros below the lowest one. Not for 0.
static inline size_t lowest_bit(uint32_t bits) { return static_cast<size_t>(__builtin_ctz(bits)); }
static inline size_t lowest_bit(uint64_t bits) {
  return static_cast<size_t>(__builtin_ctzll(bits));
}
static inline size_t count_bits(uint32_t bits) {
  return static_cast<size_t>(__builtin_popcount(bits));
}

static inline void prefetch(const void* address) { __builtin_prefetch(address); }

static inline void copy_bytes(void* to, const void* from, size_t count) {
  __builtin_memcpy(to, from, count);
}
static inline void clear_bytes(void* to, size_t count) { __builtin_memset(to, 0, count); }

}  // namespace segloc
