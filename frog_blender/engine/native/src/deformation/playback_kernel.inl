// Playback of a network without heads: GROUP_SIZE Gaussians lie in the lanes, with all that is read of them in one
// piece. No exponential or root is computed for one Gaussian alone.

// Groups that are multiplied at once: a weight that is fetched then serves two vectors, where there are registers for
// the sums.
constexpr int PLAYBACK_TOGETHER = LANES == 16 ? 2 : 1;
static_assert(PLAYBACK_TOGETHER <= PLAYBACK_MOST, "scratch memory has room for them");

// Rows of a group, canonical and deformed: means, opacity, colours and, last, the shape.
enum { PLAYBACK_MEANS = 0, PLAYBACK_OPACITY = 3, PLAYBACK_SH = 4 };
struct ShapeRows {
  int scales, quaternion, end;
  explicit ShapeRows(const FrogDeformation &field)
      : scales(PLAYBACK_SH + 3 * field.sh_deformed), quaternion(scales + 3), end(quaternion + 4) {}
};

// A vector's outputs, in place: the deformed, activated attributes.
static inline void activate_shapes(const FrogDeformation &field, const float *canonical, float *outputs) {
  const ShapeRows rows(field);
  const auto from = [&](int row) { return load(canonical + row * GROUP_SIZE); };
  const auto change = [&](int row) { return load(outputs + row * GROUP_SIZE); };
  const auto put = [&](int row, Floats value) { store(outputs + row * GROUP_SIZE, value); };
  for (int k = rows.scales; k < rows.scales + 3; ++k) put(k, exponential(from(k) + change(k)));
  Floats squares{};
  for (int k = rows.quaternion; k < rows.end; ++k) {
    const Floats q = from(k) + change(k);
    put(k, q);
    squares += q * q;
  }
  float lengths[LANES];
  store(lengths, squares);
  for (float &length : lengths) length = __builtin_sqrtf(length);
  const Floats scale = 1.0f / larger(load(lengths), all(1e-12f));
  for (int k = rows.quaternion; k < rows.end; ++k) put(k, change(k) * scale);
}
static inline void activate_others(const FrogDeformation &field, const float *canonical, float *outputs) {
  const auto from = [&](int row) { return load(canonical + row * GROUP_SIZE); };
  const auto change = [&](int row) { return load(outputs + row * GROUP_SIZE); };
  const auto put = [&](int row, Floats value) { store(outputs + row * GROUP_SIZE, value); };
  for (int k = PLAYBACK_MEANS; k < PLAYBACK_OPACITY; ++k) put(k, from(k) + field.motion_unit * change(k));
  const Floats changed = change(PLAYBACK_OPACITY), e = exponential(-(from(PLAYBACK_OPACITY) + changed));
  const Floats factor = reduces(field) ? reduction(field, exponential(-field.opacity_sharpness * changed)) : all(1.0f);
  put(PLAYBACK_OPACITY, factor / (1.0f + e));
  for (int k = PLAYBACK_SH; k < PLAYBACK_SH + 3 * field.sh_deformed; ++k) put(k, from(k) + change(k));
}

// The first `count` numbers, 1 to 4.
static inline void put_some(float *to, Quad v, int count) {
  if (count == 4) return store_4(to, v);
  if (count >= 2) __builtin_memcpy(to, &v, 2 * sizeof(float));
  if (count != 2) to[count - 1] = v[count - 1];
}

// An attribute of a group's first `count` Gaussians, (width, GROUP_SIZE), to rows of `width` numbers that are `row`
// apart: from registers, since reading what was just written in smaller pieces waits until it has reached the cache.
// Reads up to three columns beyond `width`.
static inline void give(const float *columns, int width, float *to, long long row, int count) {
  for (int o = 0; o < width; o += 4)
    for (int g = 0; g < count; g += 4) {
      const float *from = columns + o * GROUP_SIZE + g;
      Quad rows[4];
      for (int k = 0; k < 4; ++k) rows[k] = load_4(from + k * GROUP_SIZE);
#if defined(__SSE__)
      _MM_TRANSPOSE4_PS(rows[0], rows[1], rows[2], rows[3]);
#else
      for (int i = 0; i < 4; ++i)
        for (int j = 0; j < i; ++j) {
          const float swapped = rows[i][j];
          rows[i][j] = rows[j][i];
          rows[j][i] = swapped;
        }
#endif
      for (int i = 0; i < 4 && g + i < count; ++i)
        put_some(to + (g + i) * row + o, rows[i], width - o < 4 ? width - o : 4);
    }
}

// The outputs of groups from what is read of them alone.
template <int GROUPS>
static void group_network(const DeformationPlan &plan, const float *const *own, Prefetcher &prefetcher,
                          float *const *hidden, float *const *outputs) {
  if (plan.field->precomputed_first_layer)
    for (int g = 0; g < GROUPS; ++g) kept_layer(plan.hidden, own[g], plan.shared, hidden[g]);
  else
    group_layer<GROUPS, true>(plan.hidden, plan.embedding, own, plan.embedding_rows, padded(plan.hidden), plan.shared,
                              hidden, prefetcher);
  group_layer<GROUPS, false>(plan.outputs, plan.hidden, hidden, plan.output_rows, padded(plan.outputs), plan.output_bias,
                             outputs, prefetcher);
}

// A group's `count` deformed Gaussians from `start` on; `outputs` (rows, GROUP_SIZE) are overwritten.
static void finish_group(const DeformationPlan &plan, const float *canonical, float *outputs, const FrogDeformed &out,
                         long long start, int count) {
  const FrogDeformation &field = *plan.field;
  const ShapeRows rows(field);
  for (int v = 0; v < GROUP_SIZE; v += LANES) activate_shapes(field, canonical + v, outputs + v);
  give(outputs + rows.scales * GROUP_SIZE, 3, out.scales + 3 * start, 3, count);
  give(outputs + rows.quaternion * GROUP_SIZE, 4, out.quaternions + 4 * start, 4, count);
  for (int v = 0; v < GROUP_SIZE; v += LANES) activate_others(field, canonical + v, outputs + v);
  give(outputs + PLAYBACK_MEANS * GROUP_SIZE, 3, out.means + 3 * start, 3, count);
  const int active = 3 * field.sh_active, colors = 3 * field.sh_deformed < active ? 3 * field.sh_deformed : active;
  give(outputs + PLAYBACK_SH * GROUP_SIZE, colors, out.sh + active * start, active, count);
  copy(out.opacities + start, outputs + PLAYBACK_OPACITY * GROUP_SIZE, count);
}

// The groups from the Gaussian `start` on; meanwhile the memory of as many that come next is asked for: what is read of
// them and, where there are products enough, what is written.
template <int GROUPS>
static void play_groups(const DeformationPlan &plan, const DeformationLayout &l, const FrogDeformed &out,
                        long long start, int end, float *scratch) {
  const FrogDeformation &field = *plan.field;
  const int row = plan.outputs + (field.precomputed_first_layer ? plan.hidden : plan.embedding);
  const float *canonical[GROUPS], *own[GROUPS];
  float *hidden[GROUPS], *outputs[GROUPS];
  for (int g = 0; g < GROUPS; ++g) {
    canonical[g] = field.groups + (start + g * GROUP_SIZE) * row;
    own[g] = canonical[g] + plan.outputs * GROUP_SIZE;
    hidden[g] = scratch + l.first + g * GROUP_SIZE * plan.hidden;
    outputs[g] = scratch + l.columns + g * GROUP_SIZE * l.outputs;
  }
  const int gaussians = GROUPS * GROUP_SIZE;
  Prefetcher prefetcher;
  prefetcher.add(field.groups + (start + gaussians) * row, static_cast<long long>(gaussians) * row);
  if (!field.precomputed_first_layer)
    prefetch_deformed(prefetcher, out, start + gaussians, gaussians, field.sh_deformed ? 3 * field.sh_active : 0);
  group_network<GROUPS>(plan, own, prefetcher, hidden, outputs);
  for (int g = 0; g < GROUPS; ++g) {
    const long long first = start + g * GROUP_SIZE;
    const int count = end - first < GROUP_SIZE ? static_cast<int>(end - first) : static_cast<int>(GROUP_SIZE);
    finish_group(plan, canonical[g], outputs[g], out, first, count);
  }
}

static void playback(const DeformationPlan &plan, const FrogDeformed &out, int begin, int end, float *scratch) {
  const DeformationLayout l = layout_of(plan);
  long long start = begin;
  for (; start + (PLAYBACK_TOGETHER - 1) * GROUP_SIZE < end; start += PLAYBACK_TOGETHER * GROUP_SIZE)
    play_groups<PLAYBACK_TOGETHER>(plan, l, out, start, end, scratch);
  for (; start < end; start += GROUP_SIZE) play_groups<1>(plan, l, out, start, end, scratch);
}
