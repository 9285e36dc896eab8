// The network without heads from the product that playback keeps, first_layer. Gaussians lie in the lanes, KEPT_GROUP
// of them together: their sums stay in registers while the units of the first layer pass by, each read from memory once.

static_assert(KEPT_GROUP % LANES == 0, "a group is whole vectors");

// OUTPUTS outputs of a group. With FIRST, `units` is the kept product, and the units are stored in `hidden`;
// else `units` is what was stored there.
template <int OUTPUTS, bool FIRST>
static inline void group_outputs(int inner, const float *units, const float *shared, const float *weights, long long weights_row,
                                 const float *bias, float *hidden, float *result) {
  constexpr int VECTORS = KEPT_GROUP / LANES;
  Floats sums[OUTPUTS][VECTORS];
  for (int o = 0; o < OUTPUTS; ++o)
    for (int v = 0; v < VECTORS; ++v) sums[o][v] = all(bias[o]);
  for (int k = 0; k < inner; ++k, units += KEPT_GROUP, hidden += KEPT_GROUP, weights += weights_row) {
    Floats unit[VECTORS];
    if (FIRST) __builtin_prefetch(units + 2ll * inner * KEPT_GROUP);  // the group after the next
    for (int v = 0; v < VECTORS; ++v) {
      unit[v] = load(units + v * LANES);
      if (FIRST) store(hidden + v * LANES, unit[v] = larger(unit[v] + shared[k], Floats{}));
    }
    for (int o = 0; o < OUTPUTS; ++o)
      for (int v = 0; v < VECTORS; ++v) sums[o][v] += unit[v] * weights[o];
  }
  for (int o = 0; o < OUTPUTS; ++o)
    for (int v = 0; v < VECTORS; ++v) store(result + o * KEPT_GROUP + v * LANES, sums[o][v]);
}

// The same for a number of outputs that is known only now, at most OUTPUTS.
template <int OUTPUTS, bool FIRST>
static inline void group_outputs_of(int count, int inner, const float *units, const float *shared, const float *weights,
                                    long long weights_row, const float *bias, float *hidden, float *result) {
  if (count == OUTPUTS)
    group_outputs<OUTPUTS, FIRST>(inner, units, shared, weights, weights_row, bias, hidden, result);
  else if constexpr (OUTPUTS > 1)
    group_outputs_of<OUTPUTS - 1, FIRST>(count, inner, units, shared, weights, weights_row, bias, hidden, result);
}

// (outputs, KEPT_GROUP) to rows of `row` numbers for each Gaussian; a few more outputs than there are, up to a multiple of 4.
static inline void turn_group(const float *columns, int outputs, float *rows, long long row) {
  for (int o = 0; o < outputs; o += 4)
    for (int g = 0; g < KEPT_GROUP; g += 4) {
      const float *from = columns + o * KEPT_GROUP + g;
      float *to = rows + g * row + o;
#if defined(__SSE__)
      __m128 a = _mm_loadu_ps(from), b = _mm_loadu_ps(from + KEPT_GROUP), c = _mm_loadu_ps(from + 2 * KEPT_GROUP);
      __m128 d = _mm_loadu_ps(from + 3 * KEPT_GROUP);
      _MM_TRANSPOSE4_PS(a, b, c, d);
      _mm_storeu_ps(to, a), _mm_storeu_ps(to + row, b), _mm_storeu_ps(to + 2 * row, c), _mm_storeu_ps(to + 3 * row, d);
#else
      for (int i = 0; i < 4; ++i)
        for (int j = 0; j < 4; ++j) to[i * row + j] = from[j * KEPT_GROUP + i];
#endif
    }
}

// Fills the result of a block.
static void network_kept(const DeformationPlan &plan, const DeformationLayout &l, float *scratch, int begin, int rows) {
  // With the units and a weight, as many sums as registers hold: 14 of 32 in AVX-512, 12 or 8 of 16 elsewhere.
  constexpr int TOGETHER = LANES == 16 ? 14 : LANES == 8 ? 6 : 2;
  const int passes = (plan.outputs + TOGETHER - 1) / TOGETHER;
  float *hidden = scratch + l.first, *columns = scratch + l.columns;
  const long long weights_row = padded(plan.outputs);
  for (int g = 0; g < rows; g += KEPT_GROUP) {
    const float *kept = plan.field->first_layer + static_cast<long long>(begin + g) * plan.hidden;
    for (int pass = 0; pass < passes; ++pass) {
      const int first = plan.outputs * pass / passes, count = plan.outputs * (pass + 1) / passes - first;
      const float *weights = plan.output_rows + first, *bias = plan.output_bias + first;
      float *result = columns + first * KEPT_GROUP;
      if (pass == 0)
        group_outputs_of<TOGETHER, true>(count, plan.hidden, kept, plan.shared, weights, weights_row, bias, hidden, result);
      else
        group_outputs_of<TOGETHER, false>(count, plan.hidden, hidden, nullptr, weights, weights_row, bias, hidden, result);
    }
    turn_group(columns, plan.outputs, scratch + l.result + g * l.outputs, l.outputs);
  }
}
