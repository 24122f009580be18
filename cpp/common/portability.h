// Compiler-specific code. Only this header and the vector operators in simd/simd.h need GCC or
// Clang.
//
// Everything is static: a shared definition could come from a file that was built for a newer
// processor (simd/simd.h).
#pragma once

#include <cstddef>
#include <cstdint>

#if defined(__x86_64__)
#include <cpuid.h>
#endif

// Loops over registers must be unrolled completely, or their arrays live in memory.
#define SEGLOC_UNROLL _Pragma("GCC unroll 16")

// a, value by value, as a vector of another type.
#define SEGLOC_CONVERT(a, Type) __builtin_convertvector(a, Type)

// A vector type of a given size in bytes, with operators on each of its values.
#define SEGLOC_VECTOR(type, name, bytes) typedef type name __attribute__((vector_size(bytes)))

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
static inline void prefetch_to_write(const void* address) { __builtin_prefetch(address, 1); }

static inline void copy_bytes(void* to, const void* from, size_t count) {
  __builtin_memcpy(to, from, count);
}
static inline void clear_bytes(void* to, size_t count) { __builtin_memset(to, 0, count); }

#if defined(__x86_64__)
// Features of the processor that the system supports. Read by CPUID, since the compilers' built-ins
// need a run-time library that clang-cl does not link.
struct CpuFeatures {
  bool avx2, fma, avx512f, avx512dq, avx512bw, avx512vl;
};

static inline CpuFeatures cpu_features() {
  uint32_t a = 0, b = 0, c = 0, d = 0, saved = 0, high = 0;
  if (!__get_cpuid(1, &a, &b, &c, &d)) return {};
  const bool fma = (c >> 12 & 1) != 0, asks = (c >> 27 & 1) != 0;
  if (!asks || !__get_cpuid_count(7, 0, &a, &b, &c, &d)) return {};
  __asm__("xgetbv" : "=a"(saved), "=d"(high) : "c"(0));
  const bool ymm = (saved & 0x06) == 0x06, zmm = (saved & 0xe6) == 0xe6;
  const auto has = [b](int bit) { return (b >> bit & 1) != 0; };
  return {ymm && has(5),  ymm && fma,     zmm && has(16),
          zmm && has(17), zmm && has(30), zmm && has(31)};
}
#endif

}  // namespace segloc
