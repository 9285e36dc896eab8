// Playback's matrix products: of weights with units of groups of PLAYED_GROUP Gaussians, which lie in the lanes. Sums stay in
// registers.

static_assert(PLAYED_GROUP % LANES == 0, "a group is whole vectors");
constexpr int PLAYED_VECTORS = PLAYED_GROUP / LANES;

// (OUTPUTS, PLAYED_GROUP) for each of GROUPS groups from its (inner, PLAYED_GROUP) units, into rows `first` and later of its
// result: bias + weights^T units, negative numbers made zero with RELU.
template <int GROUPS, int OUTPUTS, bool RELU>
static inline void group_outputs(int inner, const float *const *units, const float *weights, long long weights_row, const float *bias,
                                 float *const *results, int first, Ahead &ahead) {
  Floats sums[OUTPUTS][GROUPS * PLAYED_VECTORS];
  for (int o = 0; o < OUTPUTS; ++o)
    for (int v = 0; v < GROUPS * PLAYED_VECTORS; ++v) sums[o][v] = all(bias[first + o]);
  weights += first;
  for (int k = 0; k < inner; ++k, weights += weights_row) {
    ahead.ask();
    Floats unit[GROUPS * PLAYED_VECTORS];
    for (int v = 0; v < GROUPS * PLAYED_VECTORS; ++v)
      unit[v] = load(units[v / PLAYED_VECTORS] + k * PLAYED_GROUP + v % PLAYED_VECTORS * LANES);
    for (int o = 0; o < OUTPUTS; ++o)
      for (int v = 0; v < GROUPS * PLAYED_VECTORS; ++v) sums[o][v] += unit[v] * weights[o];
  }
  for (int o = 0; o < OUTPUTS; ++o)
    for (int v = 0; v < GROUPS * PLAYED_VECTORS; ++v)
      store(results[v / PLAYED_VECTORS] + (first + o) * PLAYED_GROUP + v % PLAYED_VECTORS * LANES,
            RELU ? larger(sums[o][v], Floats{}) : sums[o][v]);
}

// The same for a number of outputs that is known only now, at most OUTPUTS.
template <int GROUPS, int OUTPUTS, bool RELU>
static inline void group_outputs_of(int count, int inner, const float *const *units, const float *weights, long long weights_row,
                                    const float *bias, float *const *results, int first, Ahead &ahead) {
  if (count == OUTPUTS)
    group_outputs<GROUPS, OUTPUTS, RELU>(inner, units, weights, weights_row, bias, results, first, ahead);
  else if constexpr (OUTPUTS > 1)
    group_outputs_of<GROUPS, OUTPUTS - 1, RELU>(count, inner, units, weights, weights_row, bias, results, first, ahead);
}

// The first `count` of any number of outputs; `weights` are (inner, row).
template <int GROUPS, bool RELU>
static inline void group_layer(int count, int inner, const float *const *units, const float *weights, long long row, const float *bias,
                               float *const *results, Ahead &ahead) {
  // With the units and a weight, as many sums as registers hold: 24 for two groups or 16 of 32 in AVX-512, 12 or 8 of 16 elsewhere.
  constexpr int MOST = LANES == 16 ? (GROUPS == 2 ? 12 : 16) : LANES == 8 ? 6 : 2;
  const int passes = (count + MOST - 1) / MOST;
  for (int pass = 0; pass < passes; ++pass) {
    const int first = count * pass / passes, outputs = count * (pass + 1) / passes - first;
    group_outputs_of<GROUPS, MOST, RELU>(outputs, inner, units, weights, row, bias, results, first, ahead);
  }
}

// The first layer from its kept product: what does not depend on time.
static inline void kept_layer(int count, const float *product, const float *shared, float *result) {
  for (int k = 0; k < count; ++k, product += PLAYED_GROUP, result += PLAYED_GROUP)
    for (int v = 0; v < PLAYED_GROUP; v += LANES) store(result + v, larger(load(product + v) + shared[k], Floats{}));
}
