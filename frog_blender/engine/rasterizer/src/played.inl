// Playback of a network without heads: PLAYED_GROUP Gaussians lie in the lanes, with all that is read of them in one piece.
// Sums stay in registers, and no exponential or root is computed for one Gaussian alone.

static_assert(PLAYED_GROUP % LANES == 0, "a group is whole vectors");
constexpr int PLAYED_VECTORS = PLAYED_GROUP / LANES;
constexpr int AHEAD = 2;  // which group after the one that is worked on the memory is asked for

// (OUTPUTS, PLAYED_GROUP) from (inner, PLAYED_GROUP) units: bias + weights^T units, negative numbers made zero with RELU.
template <int OUTPUTS, bool RELU>
static inline void group_outputs(int inner, const float *units, const float *weights, long long weights_row, const float *bias,
                                 float *result, Ahead &ahead) {
  Floats sums[OUTPUTS][PLAYED_VECTORS];
  for (int o = 0; o < OUTPUTS; ++o)
    for (int v = 0; v < PLAYED_VECTORS; ++v) sums[o][v] = all(bias[o]);
  for (int k = 0; k < inner; ++k, units += PLAYED_GROUP, weights += weights_row) {
    ahead.ask();
    for (int o = 0; o < OUTPUTS; ++o)
      for (int v = 0; v < PLAYED_VECTORS; ++v) sums[o][v] += load(units + v * LANES) * weights[o];
  }
  for (int o = 0; o < OUTPUTS; ++o)
    for (int v = 0; v < PLAYED_VECTORS; ++v)
      store(result + o * PLAYED_GROUP + v * LANES, RELU ? larger(sums[o][v], Floats{}) : sums[o][v]);
}

// The same for a number of outputs that is known only now, at most OUTPUTS.
template <int OUTPUTS, bool RELU>
static inline void group_outputs_of(int count, int inner, const float *units, const float *weights, long long weights_row,
                                    const float *bias, float *result, Ahead &ahead) {
  if (count == OUTPUTS)
    group_outputs<OUTPUTS, RELU>(inner, units, weights, weights_row, bias, result, ahead);
  else if constexpr (OUTPUTS > 1)
    group_outputs_of<OUTPUTS - 1, RELU>(count, inner, units, weights, weights_row, bias, result, ahead);
}

// Any number of outputs; `weights` are (inner, padded(count)).
template <bool RELU>
static inline void group_layer(int count, int inner, const float *units, const float *weights, const float *bias, float *result,
                               Ahead &ahead) {
  // With the units and a weight, as many sums as registers hold: 16 of 32 in AVX-512, 12 or 8 of 16 elsewhere.
  constexpr int TOGETHER = LANES == 16 ? 16 : LANES == 8 ? 6 : 2;
  const int passes = (count + TOGETHER - 1) / TOGETHER;
  for (int pass = 0; pass < passes; ++pass) {
    const int first = count * pass / passes, outputs = count * (pass + 1) / passes - first;
    group_outputs_of<TOGETHER, RELU>(outputs, inner, units, weights + first, padded(count), bias + first, result + first * PLAYED_GROUP,
                                     ahead);
  }
}

// The first layer from its kept product: what does not depend on time.
static inline void kept_layer(int count, const float *product, const float *shared, float *result) {
  for (int k = 0; k < count; ++k, product += PLAYED_GROUP, result += PLAYED_GROUP)
    for (int v = 0; v < PLAYED_GROUP; v += LANES) store(result + v, larger(load(product + v) + shared[k], Floats{}));
}

// A group's outputs, in place: the deformed, activated attributes.
static inline void activate_group(const FrogDeformation &field, const float *canonical, float *outputs) {
  for (int v = 0; v < PLAYED_GROUP; v += LANES, canonical += LANES, outputs += LANES) {
    const auto from = [&](int row) { return load(canonical + row * PLAYED_GROUP); };
    const auto change = [&](int row) { return load(outputs + row * PLAYED_GROUP); };
    const auto put = [&](int row, Floats value) { store(outputs + row * PLAYED_GROUP, value); };
    for (int k = OUT_MEANS; k < OUT_SCALES; ++k) put(k, from(k) + field.motion_unit * change(k));
    for (int k = OUT_SCALES; k < OUT_QUATERNIONS; ++k) put(k, exponential(from(k) + change(k)));
    Floats squares{};
    for (int k = OUT_QUATERNIONS; k < OUT_OPACITY; ++k) {
      const Floats q = from(k) + change(k);
      put(k, q), squares += q * q;
    }
    if (field.unit_quaternions) {
      float lengths[LANES];
      store(lengths, squares);
      for (float &length : lengths) length = __builtin_sqrtf(length);
      const Floats scale = 1.0f / larger(load(lengths), all(1e-12f));
      for (int k = OUT_QUATERNIONS; k < OUT_OPACITY; ++k) put(k, change(k) * scale);
    }
    const Floats changed = change(OUT_OPACITY), e = exponential(-(from(OUT_OPACITY) + changed));
    const Floats factor = reduces(field) ? reduction(field, exponential(-field.opacity_sharpness * changed)) : all(1.0f);
    put(OUT_OPACITY, factor / (1.0f + e));
    for (int k = OUT_SH; k < OUT_SH + 3 * field.sh_deformed; ++k) put(k, from(k) + change(k));
  }
}

// (width, PLAYED_GROUP) to rows of `width` numbers, and up to 3 numbers more. In fours: what reaches over a row's end is
// written again, for the next row's beginning comes later.
static inline void turn_group(const float *columns, int width, float *rows) {
  for (int o = (width - 1) / 4 * 4; o >= 0; o -= 4)
    for (int g = 0; g < PLAYED_GROUP; g += 4) {
      const float *from = columns + o * PLAYED_GROUP + g;
      float *to = rows + g * width + o;
#if defined(__SSE__)
      __m128 a = _mm_loadu_ps(from), b = _mm_loadu_ps(from + PLAYED_GROUP), c = _mm_loadu_ps(from + 2 * PLAYED_GROUP);
      __m128 d = _mm_loadu_ps(from + 3 * PLAYED_GROUP);
      _MM_TRANSPOSE4_PS(a, b, c, d);
      _mm_storeu_ps(to, a), _mm_storeu_ps(to + width, b), _mm_storeu_ps(to + 2 * width, c), _mm_storeu_ps(to + 3 * width, d);
#else
      for (int i = 0; i < 4; ++i)
        for (int j = 0; j < 4; ++j) to[i * width + j] = from[j * PLAYED_GROUP + i];
#endif
    }
}

// An attribute of the first `count` Gaussians of a group to rows that are `row` apart.
static inline void give(const float *columns, int width, float *turned, float *to, long long row, int count) {
  turn_group(columns, width, turned);
  if (row == width) return copy(to, turned, width * count);
  for (int r = 0; r < count; ++r) copy(to + r * row, turned + r * width, width);
}

static void group_network(const DeformationPlan &plan, const float *own, Ahead &ahead, float *hidden, float *outputs) {
  if (plan.field->kept_products)
    kept_layer(plan.hidden, own, plan.shared, hidden);
  else
    group_layer<true>(plan.hidden, plan.embedding, own, plan.embedding_rows, plan.shared, hidden, ahead);
  group_layer<false>(plan.outputs, plan.hidden, hidden, plan.output_rows, plan.output_bias, outputs, ahead);
}

static inline void put_zeros(float *values, int count) {
  for (int k = 0; k < count; ++k) values[k] = 0;
}

static void play(const DeformationPlan &plan, const FrogDeformed &out, int begin, int end, float *scratch) {
  const FrogDeformation &field = *plan.field;
  const DeformationLayout l = layout_of(plan);
  const int row = plan.outputs + (field.kept_products ? plan.hidden : plan.embedding);
  float *hidden = scratch + l.first, *outputs = scratch + l.columns, *turned = scratch + l.result;
  for (long long start = begin; start < end; start += PLAYED_GROUP) {
    const int count = static_cast<int>(end - start < PLAYED_GROUP ? end - start : PLAYED_GROUP);
    const long long group = start / PLAYED_GROUP;
    const float *canonical = field.groups + start * row;
    Ahead ahead;
    ahead.add(canonical + AHEAD * PLAYED_GROUP * row, PLAYED_GROUP * row);
    const bool seen = !field.active || field.active[group];
    if (!seen && out.stirred && out.stirred[group] == 0) continue;
    if (out.stirred) out.stirred[group] = seen;
    if (seen)
      group_network(plan, canonical + plan.outputs * PLAYED_GROUP, ahead, hidden, outputs);
    else
      put_zeros(outputs, plan.outputs * PLAYED_GROUP);
    activate_group(field, canonical, outputs);
    if (!seen) put_zeros(outputs + OUT_OPACITY * PLAYED_GROUP, PLAYED_GROUP);
    const auto column = [&](int output) { return outputs + output * PLAYED_GROUP; };
    give(column(OUT_MEANS), 3, turned, out.means + 3 * start, 3, count);
    give(column(OUT_SCALES), 3, turned, out.scales + 3 * start, 3, count);
    give(column(OUT_QUATERNIONS), 4, turned, out.quaternions + 4 * start, 4, count);
    copy(out.opacities + start, column(OUT_OPACITY), count);
    const int active = 3 * field.sh_active, colors = 3 * field.sh_deformed < active ? 3 * field.sh_deformed : active;
    if (colors) give(column(OUT_SH), colors, turned, out.sh + active * start, active, count);
  }
}
