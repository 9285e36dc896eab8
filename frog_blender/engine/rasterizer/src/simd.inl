// A register's worth of floats, by the compilers' vector extension. The width is the machine's own: wider types are
// taken apart into scalars and were several times slower.
constexpr int LANES = FROG_VECTOR_BYTES / 4;
typedef float Floats __attribute__((vector_size(FROG_VECTOR_BYTES)));
typedef int32_t Ints __attribute__((vector_size(FROG_VECTOR_BYTES)));

static inline Floats all(float value) { return value - Floats{}; }
static inline Floats load(const float *from) { Floats v; __builtin_memcpy(&v, from, sizeof v); return v; }
static inline void store(float *to, Floats v) { __builtin_memcpy(to, &v, sizeof v); }
static inline Ints load(const int32_t *from) { Ints v; __builtin_memcpy(&v, from, sizeof v); return v; }
static inline void store(int32_t *to, Ints v) { __builtin_memcpy(to, &v, sizeof v); }

static inline bool any(Ints mask) {  // lanes are 0 or -1
#if FROG_VECTOR_BYTES == 32 && defined(__AVX2__)
  return __builtin_ia32_movmskps256((Floats)mask) != 0;
#elif FROG_VECTOR_BYTES == 16 && defined(__SSE__)
  return __builtin_ia32_movmskps((Floats)mask) != 0;
#else
  typedef int64_t Longs __attribute__((vector_size(FROG_VECTOR_BYTES)));
  const Longs wide = (Longs)mask;
  int64_t joined = 0;
  for (int i = 0; i < LANES / 2; ++i) joined |= wide[i];
  return joined != 0;
#endif
}

static inline float sum(Floats v) {  // by halves: a fixed order, whatever the thread
  float parts[LANES];
  store(parts, v);
  for (int width = LANES / 2; width > 0; width /= 2)
    for (int i = 0; i < width; ++i) parts[i] += parts[i + width];
  return parts[0];
}

static inline float largest(Floats v) {
  float result = v[0];
  for (int i = 1; i < LANES; ++i) result = v[i] > result ? v[i] : result;
  return result;
}

// 2^x for x <= 0, relative error below 2e-7; anything below -30 gives 2^-30 (far under every threshold here).
static inline Floats exp2_nonpositive(Floats x) {
  x = x > all(-30.0f) ? x : all(-30.0f);
  const Ints whole = __builtin_convertvector(x - 0.5f, Ints);  // truncation of x - 1/2 rounds a negative x
  const Floats f = x - __builtin_convertvector(whole, Floats);
  Floats p = all(1.535336188319500e-4f);  // minimax on [-1/2, 1/2] (Cephes' exp2f coefficients)
  p = p * f + 1.339887440266574e-3f;
  p = p * f + 9.618437357674640e-3f;
  p = p * f + 5.550332471162809e-2f;
  p = p * f + 2.402264791363012e-1f;
  p = p * f + 6.931472028550421e-1f;
  p = p * f + 1.0f;
  return (Floats)((Ints)p + (whole << 23));
}
