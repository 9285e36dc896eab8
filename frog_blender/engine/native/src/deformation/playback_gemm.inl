// Playback's matrix products: of weights with units of groups of GROUP_SIZE Gaussians, which lie in the lanes. Sums
// stay in registers.

static_assert(GROUP_SIZE % LANES == 0, "a group is whole vectors");
constexpr int PLAYBACK_VECTORS = GROUP_SIZE / LANES;

// (OUTPUTS, GROUP_SIZE) for each of GROUPS groups from its (inner, GROUP_SIZE) units, into rows `first` and later of
// its result: bias + weights^T units, negative numbers made zero with RELU.
template <int GROUPS, int OUTPUTS, bool RELU>
static inline void group_outputs(int inner, const float *const *units, const float *weights, long long weights_row,
                                 const float *bias, float *const *results, int first, Prefetcher &prefetcher) {
  Floats sums[OUTPUTS][GROUPS * PLAYBACK_VECTORS];
  for (int o = 0; o < OUTPUTS; ++o)
    for (int v = 0; v < GROUPS * PLAYBACK_VECTORS; ++v) sums[o][v] = all(bias[first + o]);
  weights += first;
  for (int k = 0; k < inner; ++k, weights += weights_row) {
    prefetcher.next();
    Floats unit[GROUPS * PLAYBACK_VECTORS];
    for (int v = 0; v < GROUPS * PLAYBACK_VECTORS; ++v)
      unit[v] = load(units[v / PLAYBACK_VECTORS] + k * GROUP_SIZE + v % PLAYBACK_VECTORS * LANES);
    for (int o = 0; o < OUTPUTS; ++o)
      for (int v = 0; v < GROUPS * PLAYBACK_VECTORS; ++v) sums[o][v] += unit[v] * weights[o];
  }
  for (int o = 0; o < OUTPUTS; ++o)
    for (int v = 0; v < GROUPS * PLAYBACK_VECTORS; ++v)
      store(results[v / PLAYBACK_VECTORS] + (first + o) * GROUP_SIZE + v % PLAYBACK_VECTORS * LANES,
            RELU ? larger(sums[o][v], Floats{}) : sums[o][v]);
}

// The same for a number of outputs that is known only now, at most OUTPUTS.
template <int GROUPS, int OUTPUTS, bool RELU>
static inline void group_outputs_of(int count, int inner, const float *const *units, const float *weights,
                                    long long weights_row, const float *bias, float *const *results, int first,
                                    Prefetcher &prefetcher) {
  if (count == OUTPUTS)
    group_outputs<GROUPS, OUTPUTS, RELU>(inner, units, weights, weights_row, bias, results, first, prefetcher);
  else if constexpr (OUTPUTS > 1)
    group_outputs_of<GROUPS, OUTPUTS - 1, RELU>(count, inner, units, weights, weights_row, bias, results, first,
                                                prefetcher);
}

// The first `count` of any number of outputs; `weights` are (inner, row).
template <int GROUPS, bool RELU>
static inline void group_layer(int count, int inner, const float *const *units, const float *weights, long long row,
                               const float *bias, float *const *results, Prefetcher &prefetcher) {
  // With the units and a weight, as many sums as registers hold: 24 for two groups or 16 of 32 in AVX-512, 12 or 8 of
  // 16 elsewhere.
  constexpr int MOST = LANES == 16 ? (GROUPS == 2 ? 12 : 16) : LANES == 8 ? 6 : 2;
  const int passes = (count + MOST - 1) / MOST;
  for (int pass = 0; pass < passes; ++pass) {
    const int first = count * pass / passes, outputs = count * (pass + 1) / passes - first;
    group_outputs_of<GROUPS, MOST, RELU>(outputs, inner, units, weights, row, bias, results, first, prefetcher);
  }
}

// The first layer from its kept product: what does not depend on time.
static inline void kept_layer(int count, const float *product, const float *shared, float *result) {
  for (int k = 0; k < count; ++k, product += GROUP_SIZE, result += GROUP_SIZE)
    for (int v = 0; v < GROUP_SIZE; v += LANES) store(result + v, larger(load(product + v) + shared[k], Floats{}));
}
