// The few vector operations that the kernels need, for the instruction set that this translation
// unit is compiled for. Everything lives in the namespace SEGLOC_ISA: the linker must never merge
// a function built with AVX-512 flags with one that old processors run. For the same reason the
// kernels instantiate nothing from the standard library.
//
// Needs the vector extensions of GCC or Clang. On processors other than x86 the generic section
// becomes whatever the compiler has: NEON on aarch64, with the bits of SSE2.
#pragma once

#include <cstddef>
#include <cstdint>

#include "common/portability.h"

#if defined(__AVX2__)
#include <immintrin.h>
#elif defined(__SSE2__)
#include <emmintrin.h>
#elif defined(__aarch64__)
#include <arm_neon.h>
#endif

#ifndef SEGLOC_ISA
#error "define SEGLOC_ISA before including a kernel"
#endif

namespace segloc {
namespace SEGLOC_ISA {
namespace {

#if defined(__AVX512F__)

using Vec = __m512;
constexpr int kWidth = 16;
constexpr int kRegisters = 32;

inline Vec load(const float* p) { return _mm512_loadu_ps(p); }
inline Vec load_bytes(const uint8_t* p) {
  const __m128i bytes = _mm_loadu_si128(reinterpret_cast<const __m128i*>(p));
  return _mm512_cvtepi32_ps(_mm512_cvtepu8_epi32(bytes));
}
inline void store(float* p, Vec a) { _mm512_storeu_ps(p, a); }
inline void store_whole(int32_t* p, Vec a) { _mm512_storeu_si512(p, _mm512_cvtps_epi32(a)); }
inline Vec broadcast(float a) { return _mm512_set1_ps(a); }
inline Vec min(Vec a, Vec b) { return _mm512_min_ps(a, b); }
inline Vec max(Vec a, Vec b) { return _mm512_max_ps(a, b); }
inline Vec fma(Vec a, Vec b, Vec c) { return _mm512_fmadd_ps(a, b, c); }
inline uint32_t equal(Vec a, Vec b) { return _mm512_cmp_ps_mask(a, b, _CMP_EQ_OQ); }
inline uint32_t less_equal(Vec a, Vec b) { return _mm512_cmp_ps_mask(a, b, _CMP_LE_OQ); }
inline float reduce_max(Vec a) { return _mm512_reduce_max_ps(a); }
inline float reduce_min(Vec a) { return _mm512_reduce_min_ps(a); }
// Which of a vector's width of bits are set.
inline uint32_t bits_at(const uint32_t* bits, const uint32_t* at) {
  const __m512i where = _mm512_loadu_si512(at);
  const __m512i words = _mm512_i32gather_epi32(_mm512_srli_epi32(where, 5), bits, 4);
  const __m512i bit = _mm512_sllv_epi32(
      _mm512_set1_epi32(1), _mm512_and_si512(where, _mm512_set1_epi32(31)));
  return _mm512_test_epi32_mask(words, bit);
}
// 2^a for whole numbers n = round(a), times p.
inline Vec round(Vec a) { return _mm512_roundscale_ps(a, _MM_FROUND_TO_NEAREST_INT); }
inline Vec scale_by_power(Vec p, Vec n) { return _mm512_scalef_ps(p, n); }
// a > b ? x : y
inline Vec choose(Vec a, Vec b, Vec x, Vec y) {
  return _mm512_mask_mov_ps(y, _mm512_cmp_ps_mask(a, b, _CMP_GT_OQ), x);
}
// a == b ? x : y
inline Vec choose_equal(Vec a, Vec b, Vec x, Vec y) {
  return _mm512_mask_mov_ps(y, _mm512_cmp_ps_mask(a, b, _CMP_EQ_OQ), x);
}
// Adds one where v <= x.
inline Vec count_not_above(Vec count, Vec v, Vec x) {
  return _mm512_mask_add_ps(count, _mm512_cmp_ps_mask(v, x, _CMP_LE_OQ), count, broadcast(1.0f));
}
// Adds one where v comes before x: v < x, or v == x and i < j.
inline Vec count_before(Vec count, Vec v, Vec x, Vec i, Vec j) {
  const __mmask16 tie =
      _mm512_mask_cmp_ps_mask(_mm512_cmp_ps_mask(i, j, _CMP_LT_OQ), v, x, _CMP_EQ_OQ);
  const __mmask16 before = static_cast<__mmask16>(tie | _mm512_cmp_ps_mask(v, x, _CMP_LT_OQ));
  return _mm512_mask_add_ps(count, before, count, broadcast(1.0f));
}

#elif defined(__AVX2__)

using Vec = __m256;
constexpr int kWidth = 8;
constexpr int kRegisters = 16;

inline Vec load(const float* p) { return _mm256_loadu_ps(p); }
inline Vec load_bytes(const uint8_t* p) {
  const __m128i bytes = _mm_loadl_epi64(reinterpret_cast<const __m128i*>(p));
  return _mm256_cvtepi32_ps(_mm256_cvtepu8_epi32(bytes));
}
inline void store(float* p, Vec a) { _mm256_storeu_ps(p, a); }
inline void store_whole(int32_t* p, Vec a) {
  _mm256_storeu_si256(reinterpret_cast<__m256i*>(p), _mm256_cvtps_epi32(a));
}
inline Vec broadcast(float a) { return _mm256_set1_ps(a); }
inline Vec min(Vec a, Vec b) { return _mm256_min_ps(a, b); }
inline Vec max(Vec a, Vec b) { return _mm256_max_ps(a, b); }
inline Vec fma(Vec a, Vec b, Vec c) { return _mm256_fmadd_ps(a, b, c); }
inline uint32_t equal(Vec a, Vec b) {
  return static_cast<uint32_t>(_mm256_movemask_ps(_mm256_cmp_ps(a, b, _CMP_EQ_OQ)));
}
inline uint32_t less_equal(Vec a, Vec b) {
  return static_cast<uint32_t>(_mm256_movemask_ps(_mm256_cmp_ps(a, b, _CMP_LE_OQ)));
}
inline uint32_t bits_at(const uint32_t* bits, const uint32_t* at) {
  const __m256i where = _mm256_loadu_si256(reinterpret_cast<const __m256i*>(at));
  const __m256i words = _mm256_i32gather_epi32(reinterpret_cast<const int*>(bits),
                                               _mm256_srli_epi32(where, 5), 4);
  const __m256i before =
      _mm256_sub_epi32(_mm256_set1_epi32(31), _mm256_and_si256(where, _mm256_set1_epi32(31)));
  return static_cast<uint32_t>(
      _mm256_movemask_ps(_mm256_castsi256_ps(_mm256_sllv_epi32(words, before))));
}
inline float reduce_max(Vec a) {
  __m128 m = _mm_max_ps(_mm256_castps256_ps128(a), _mm256_extractf128_ps(a, 1));
  m = _mm_max_ps(m, _mm_movehl_ps(m, m));
  return _mm_cvtss_f32(_mm_max_ss(m, _mm_shuffle_ps(m, m, 1)));
}
inline float reduce_min(Vec a) {
  __m128 m = _mm_min_ps(_mm256_castps256_ps128(a), _mm256_extractf128_ps(a, 1));
  m = _mm_min_ps(m, _mm_movehl_ps(m, m));
  return _mm_cvtss_f32(_mm_min_ss(m, _mm_shuffle_ps(m, m, 1)));
}
inline Vec round(Vec a) {
  return _mm256_round_ps(a, _MM_FROUND_TO_NEAREST_INT | _MM_FROUND_NO_EXC);
}
inline Vec scale_by_power(Vec p, Vec n) {
  const __m256i shift = _mm256_slli_epi32(_mm256_cvtps_epi32(n), 23);
  return _mm256_castsi256_ps(_mm256_add_epi32(_mm256_castps_si256(p), shift));
}
inline Vec choose(Vec a, Vec b, Vec x, Vec y) {
  return _mm256_blendv_ps(y, x, _mm256_cmp_ps(a, b, _CMP_GT_OQ));
}
inline Vec choose_equal(Vec a, Vec b, Vec x, Vec y) {
  return _mm256_blendv_ps(y, x, _mm256_cmp_ps(a, b, _CMP_EQ_OQ));
}
inline Vec count_not_above(Vec count, Vec v, Vec x) {
  return count + _mm256_and_ps(_mm256_cmp_ps(v, x, _CMP_LE_OQ), broadcast(1.0f));
}
inline Vec count_before(Vec count, Vec v, Vec x, Vec i, Vec j) {
  const Vec tie = _mm256_and_ps(_mm256_cmp_ps(v, x, _CMP_EQ_OQ), _mm256_cmp_ps(i, j, _CMP_LT_OQ));
  const Vec before = _mm256_or_ps(tie, _mm256_cmp_ps(v, x, _CMP_LT_OQ));
  return count + _mm256_and_ps(before, broadcast(1.0f));
}

#else

SEGLOC_VECTOR(float, Vec, 16);
SEGLOC_VECTOR(int32_t, IntVec, 16);
constexpr int kWidth = 4;
#if defined(__aarch64__)
constexpr int kRegisters = 32;
#else
constexpr int kRegisters = 16;
#endif

inline Vec load(const float* p) {
  Vec a;
  copy_bytes(&a, p, sizeof(a));
  return a;
}
#if defined(__SSE2__)
inline Vec load_bytes(const uint8_t* p) {
  int32_t four;
  copy_bytes(&four, p, sizeof(four));
  const __m128i none = _mm_setzero_si128();
  const __m128i halves = _mm_unpacklo_epi8(_mm_cvtsi32_si128(four), none);
  return _mm_cvtepi32_ps(_mm_unpacklo_epi16(halves, none));
}
#else
inline Vec load_bytes(const uint8_t* p) {
  return SEGLOC_CONVERT((IntVec{p[0], p[1], p[2], p[3]}), Vec);
}
#endif
inline void store(float* p, Vec a) { copy_bytes(p, &a, sizeof(a)); }
inline void store_whole(int32_t* p, Vec a) {
  const IntVec whole = SEGLOC_CONVERT(a, IntVec);
  copy_bytes(p, &whole, sizeof(whole));
}
inline Vec broadcast(float a) { return Vec{a, a, a, a}; }
inline Vec select(IntVec mask, Vec a, Vec b) {
  return reinterpret_cast<Vec>((mask & reinterpret_cast<IntVec>(a)) |
                               (~mask & reinterpret_cast<IntVec>(b)));
}
#if defined(__SSE2__)
inline Vec min(Vec a, Vec b) { return _mm_min_ps(a, b); }
inline Vec max(Vec a, Vec b) { return _mm_max_ps(a, b); }
inline uint32_t bits(IntVec mask) {
  return static_cast<uint32_t>(_mm_movemask_ps(reinterpret_cast<Vec>(mask)));
}
#else
inline Vec min(Vec a, Vec b) { return select(a < b, a, b); }
inline Vec max(Vec a, Vec b) { return select(a > b, a, b); }
#if defined(__aarch64__)
inline uint32_t bits(IntVec mask) {
  return vaddvq_u32(reinterpret_cast<uint32x4_t>(mask & IntVec{1, 2, 4, 8}));
}
#else
inline uint32_t bits(IntVec mask) {
  return (mask[0] & 1) | (mask[1] & 2) | (mask[2] & 4) | (mask[3] & 8);
}
#endif
#endif
inline Vec fma(Vec a, Vec b, Vec c) { return a * b + c; }
inline uint32_t equal(Vec a, Vec b) { return bits(a == b); }
inline uint32_t less_equal(Vec a, Vec b) { return bits(a <= b); }
inline uint32_t bits_at(const uint32_t* bits, const uint32_t* at) {
  uint32_t set = 0;
  for (int i = 0; i < kWidth; ++i) set |= (bits[at[i] >> 5] >> (at[i] & 31) & 1u) << i;
  return set;
}
inline float reduce_max(Vec a) {
  const float low = a[0] > a[1] ? a[0] : a[1];
  const float high = a[2] > a[3] ? a[2] : a[3];
  return low > high ? low : high;
}
inline float reduce_min(Vec a) {
  const float low = a[0] < a[1] ? a[0] : a[1];
  const float high = a[2] < a[3] ? a[2] : a[3];
  return low < high ? low : high;
}
inline Vec round(Vec a) {
  const Vec magic = broadcast(12582912.0f);  // 1.5 * 2^23: its last bit is worth one
  return (a + magic) - magic;
}
inline Vec scale_by_power(Vec p, Vec n) {
  const IntVec shift = SEGLOC_CONVERT(n, IntVec) << 23;
  return reinterpret_cast<Vec>(reinterpret_cast<IntVec>(p) + shift);
}
inline Vec choose(Vec a, Vec b, Vec x, Vec y) { return select(a > b, x, y); }
inline Vec choose_equal(Vec a, Vec b, Vec x, Vec y) { return select(a == b, x, y); }
inline Vec count_not_above(Vec count, Vec v, Vec x) {
  return count + select(v <= x, broadcast(1.0f), broadcast(0.0f));
}
inline Vec count_before(Vec count, Vec v, Vec x, Vec i, Vec j) {
  const IntVec before = (v < x) | ((v == x) & (i < j));
  return count + select(before, broadcast(1.0f), broadcast(0.0f));
}

#endif

#if defined(__AVX512F__)
// Appends first + i to `found` for each set bit i of the hits; up to 15 values behind are written.
inline size_t append_fast(uint32_t hits, size_t first, uint32_t* found, size_t count) {
  const __m512i each =
      _mm512_setr_epi32(0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15);
  const __m512i index = _mm512_add_epi32(each, _mm512_set1_epi32(static_cast<int>(first)));
  const auto mask = static_cast<__mmask16>(hits);
  _mm512_storeu_si512(found + count, _mm512_maskz_compress_epi32(mask, index));
  return count + count_bits(hits);
}
#else
inline size_t append_fast(uint32_t hits, size_t first, uint32_t* found, size_t count) {
  for (; hits != 0; hits &= hits - 1) {
    found[count++] = static_cast<uint32_t>(first) + static_cast<uint32_t>(lowest_bit(hits));
  }
  return count;
}
#endif

// Appends first + i to `found` for each set bit i of the hits, up to `end`; the new count.
inline size_t append(uint32_t hits, size_t first, size_t end, uint32_t* found, size_t count) {
  if (end - first < kWidth) hits &= (1u << (end - first)) - 1u;
  for (; hits != 0; hits &= hits - 1) {
    found[count++] = static_cast<uint32_t>(first) + static_cast<uint32_t>(lowest_bit(hits));
  }
  return count;
}

// x for x > 0, exp(x) - 1 otherwise; absolute error below 3e-7. 2^f on [-1/2, 1/2] is a polynomial
// with a relative error below 1e-7.
inline Vec elu(Vec x) {
  const Vec t = min(max(x, broadcast(-80.0f)), broadcast(0.0f)) * broadcast(1.442695041f);
  const Vec n = round(t);
  const Vec f = t - n;
  Vec p = broadcast(1.326472716e-3f);
  p = fma(p, f, broadcast(9.671512889e-3f));
  p = fma(p, f, broadcast(5.550733746e-2f));
  p = fma(p, f, broadcast(2.402224208e-1f));
  p = fma(p, f, broadcast(6.931469776e-1f));
  p = fma(p, f, broadcast(1.0f));
  return choose(x, broadcast(0.0f), x, scale_by_power(p, n) - broadcast(1.0f));
}

}  // namespace
}  // namespace SEGLOC_ISA
}  // namespace segloc
