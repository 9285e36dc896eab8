// A register's worth of floats and of truth values. The width is the machine's own: wider types are taken apart into
// scalars and were several times slower. Arithmetic is the compilers' vector extension; what it has no word for, or
// says badly, is written with intrinsics where there are any.
constexpr int LANES = FROG_VECTOR_BYTES / 4;
typedef float Floats __attribute__((vector_size(FROG_VECTOR_BYTES)));
typedef int32_t Ints __attribute__((vector_size(FROG_VECTOR_BYTES)));
typedef uint32_t Bits __attribute__((vector_size(FROG_VECTOR_BYTES)));

static inline Floats all(float value) { return value - Floats{}; }
static inline Ints all_ints(int32_t value) { return value - Ints{}; }
static inline Floats load(const float *from) {
  Floats v;
  __builtin_memcpy(&v, from, sizeof v);
  return v;
}
static inline void store(float *to, Floats v) { __builtin_memcpy(to, &v, sizeof v); }
static inline Ints load(const int32_t *from) {
  Ints v;
  __builtin_memcpy(&v, from, sizeof v);
  return v;
}
static inline void store(int32_t *to, Ints v) { __builtin_memcpy(to, &v, sizeof v); }

// 2^f on [-1/2, 1/2], minimax of degree 5: relative error below 2.5e-7 with its rounding.
static inline Floats exp2_fraction(Floats f) {
  // In pairs (Estrin's scheme): what waits for it, waits for three operations instead of five.
  const Floats square = f * f, low = 6.931469440460205e-1f * f + 1.0000001192092896f;
  const Floats middle = 5.550713092088699e-2f * f + 2.4022120237350464e-1f,
               high = 1.3276472454890609e-3f * f + 9.675540961325169e-3f;
  return (high * square + middle) * square + low;
}

#if FROG_VECTOR_BYTES == 64

typedef __mmask16 Mask;
static inline Mask at_least(Floats a, Floats b) { return _mm512_cmp_ps_mask(a, b, _CMP_GE_OQ); }
static inline Mask at_least(Mask mask, Floats a, Floats b) { return _mm512_mask_cmp_ps_mask(mask, a, b, _CMP_GE_OQ); }
static inline Mask above(Ints a, int32_t b) { return _mm512_cmpgt_epi32_mask((__m512i)a, _mm512_set1_epi32(b)); }
static inline Mask above(Mask mask, Ints a, int32_t b) {
  return _mm512_mask_cmpgt_epi32_mask(mask, (__m512i)a, _mm512_set1_epi32(b));
}
static inline Mask and_not(Mask mask, Mask other) { return _kandn_mask16(other, mask); }
static inline bool any(Mask mask) { return mask != 0; }
static inline uint32_t bits(Mask mask) { return mask; }
static inline int count(Mask mask) { return __builtin_popcount(mask); }
static inline Floats keep(Mask mask, Floats v) { return _mm512_maskz_mov_ps(mask, v); }
static inline Floats choose(Mask mask, Floats yes, Floats no) { return _mm512_mask_mov_ps(no, mask, yes); }
static inline Ints choose(Mask mask, int32_t yes, Ints no) {
  return (Ints)_mm512_mask_set1_epi32((__m512i)no, mask, yes);
}
static inline void store(Mask mask, int32_t *to, Ints v) { _mm512_mask_storeu_epi32(to, mask, (__m512i)v); }
static inline Floats negative(Mask mask, Floats v) {
  return (Floats)_mm512_mask_or_epi32((__m512i)v, mask, (__m512i)v, _mm512_set1_epi32(INT32_MIN));
}
static inline Floats without(Floats v, Floats share) { return _mm512_fnmadd_ps(v, share, v); }
static inline Floats smaller(Floats a, Floats b) { return _mm512_min_ps(a, b); }
static inline Floats larger(Floats a, Floats b) { return _mm512_max_ps(a, b); }
static inline Floats exp2(Floats x) {
  const Floats whole = _mm512_roundscale_ps(x, _MM_FROUND_TO_NEAREST_INT | _MM_FROUND_NO_EXC);
  return _mm512_scalef_ps(exp2_fraction(x - whole), whole);
}
static inline float sum(Floats v) { return _mm512_reduce_add_ps(v); }

// The sums of eight vectors at once: transposed while they are added.
static inline void sums_of_8(const Floats *v, float *out) {
  __m512 quads[2];
  for (int i = 0; i < 2; ++i) {
    const __m512 a =
        _mm512_add_ps(_mm512_unpacklo_ps(v[4 * i], v[4 * i + 1]), _mm512_unpackhi_ps(v[4 * i], v[4 * i + 1]));
    const __m512 b =
        _mm512_add_ps(_mm512_unpacklo_ps(v[4 * i + 2], v[4 * i + 3]), _mm512_unpackhi_ps(v[4 * i + 2], v[4 * i + 3]));
    quads[i] = _mm512_add_ps((__m512)_mm512_unpacklo_pd((__m512d)a, (__m512d)b),
                             (__m512)_mm512_unpackhi_pd((__m512d)a, (__m512d)b));
  }
  const __m512 e =
      _mm512_add_ps(_mm512_shuffle_f32x4(quads[0], quads[1], 0x88), _mm512_shuffle_f32x4(quads[0], quads[1], 0xdd));
  const __m512 f = _mm512_add_ps(_mm512_shuffle_f32x4(e, e, 0x08), _mm512_shuffle_f32x4(e, e, 0x0d));
  _mm256_storeu_ps(out, _mm512_castps512_ps256(f));
}

#else

typedef Ints Mask;  // lanes are 0 or -1
static inline Mask at_least(Floats a, Floats b) { return a >= b; }
static inline Mask at_least(Mask mask, Floats a, Floats b) { return mask & (a >= b); }
static inline Mask above(Ints a, int32_t b) { return a > b; }
static inline Mask above(Mask mask, Ints a, int32_t b) { return mask & (a > b); }
static inline Mask and_not(Mask mask, Mask other) { return mask & ~other; }
static inline uint32_t bits(Mask mask) {
#if FROG_VECTOR_BYTES == 32
  return _mm256_movemask_ps((__m256)mask);
#elif defined(__SSE__)
  return _mm_movemask_ps((__m128)mask);
#else
  uint32_t joined = 0;
  for (int i = 0; i < LANES; ++i) joined |= mask[i] & 1u << i;
  return joined;
#endif
}
static inline bool any(Mask mask) { return bits(mask) != 0; }
static inline int count(Mask mask) { return __builtin_popcount(bits(mask)); }
static inline Floats keep(Mask mask, Floats v) { return (Floats)(mask & (Ints)v); }
static inline Floats choose(Mask mask, Floats yes, Floats no) { return mask ? yes : no; }
static inline Ints choose(Mask mask, int32_t yes, Ints no) { return mask ? yes - Ints{} : no; }
static inline void store(Mask mask, int32_t *to, Ints v) { store(to, mask ? v : load(to)); }
static inline Floats negative(Mask mask, Floats v) { return (Floats)((Ints)v | (mask & INT32_MIN)); }
#if FROG_VECTOR_BYTES == 32
static inline Floats without(Floats v, Floats share) { return _mm256_fnmadd_ps(v, share, v); }
static inline Floats smaller(Floats a, Floats b) { return _mm256_min_ps(a, b); }
static inline Floats larger(Floats a, Floats b) { return _mm256_max_ps(a, b); }
#else
static inline Floats without(Floats v, Floats share) { return v * (1 - share); }
static inline Floats smaller(Floats a, Floats b) { return a < b ? a : b; }
static inline Floats larger(Floats a, Floats b) { return a > b ? a : b; }
#endif
// Lanes that overflow come out as rubbish, and are masked by all callers.
static inline Floats exp2(Floats x) {
#if FROG_VECTOR_BYTES == 32
  const Floats whole = _mm256_round_ps(x, _MM_FROUND_TO_NEAREST_INT | _MM_FROUND_NO_EXC);
  return (Floats)((Bits)exp2_fraction(x - whole) + ((Bits)_mm256_cvtps_epi32(x) << 23));
#else
  constexpr float ROUND = 12582912.0f;  // 1.5 * 2^23: rounds what it is added to, whose last digit becomes a one
  const Floats shifted = x + ROUND;
  return (Floats)((Bits)exp2_fraction(x - (shifted - ROUND)) + ((Bits)shifted << 23));
#endif
}
static inline float sum(Floats v) {  // by halves: a fixed order
  float parts[LANES];
  store(parts, v);
  for (int width = LANES / 2; width > 0; width /= 2)
    for (int i = 0; i < width; ++i) parts[i] += parts[i + width];
  return parts[0];
}
#if FROG_VECTOR_BYTES == 32
static inline void sums_of_8(const Floats *v, float *out) {  // transposed while they are added
  __m256 quads[2];
  for (int i = 0; i < 2; ++i)
    quads[i] = _mm256_hadd_ps(_mm256_hadd_ps(v[4 * i], v[4 * i + 1]), _mm256_hadd_ps(v[4 * i + 2], v[4 * i + 3]));
  _mm256_storeu_ps(out, _mm256_add_ps(_mm256_permute2f128_ps(quads[0], quads[1], 0x20),
                                      _mm256_permute2f128_ps(quads[0], quads[1], 0x31)));
}
#else
static inline void sums_of_8(const Floats *v, float *out) {
  for (int i = 0; i < 8; ++i) out[i] = sum(v[i]);
}
#endif
#endif

static inline float largest(Floats v) {
  float result = v[0];
  for (int i = 1; i < LANES; ++i) result = v[i] > result ? v[i] : result;
  return result;
}
