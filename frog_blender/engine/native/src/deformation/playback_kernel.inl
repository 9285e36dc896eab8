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
  if (!field.unit_quaternions) return;
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

static inline void put_zeros(float *values, int count) {
  for (int k = 0; k < count; ++k) values[k] = 0;
}

// Shapes of a group's `count` Gaussians from `start` on, which change as `outputs` say, in place.
static void finish_shapes(const DeformationPlan &plan, const float *canonical, float *outputs, const FrogDeformed &out,
                          long long start, int count) {
  const ShapeRows rows(*plan.field);
  for (int v = 0; v < GROUP_SIZE; v += LANES) activate_shapes(*plan.field, canonical + v, outputs + v);
  give(outputs + rows.scales * GROUP_SIZE, 3, out.scales + 3 * start, 3, count);
  give(outputs + rows.quaternion * GROUP_SIZE, 4, out.quaternions + 4 * start, 4, count);
}

// What else there is of them, (rows, GROUP_SIZE).
static void give_others(const FrogDeformation &field, const float *rows, const FrogDeformed &out, long long start,
                        int count) {
  give(rows + PLAYBACK_MEANS * GROUP_SIZE, 3, out.means + 3 * start, 3, count);
  const int active = 3 * field.sh_active, colors = 3 * field.sh_deformed < active ? 3 * field.sh_deformed : active;
  give(rows + PLAYBACK_SH * GROUP_SIZE, colors, out.sh + active * start, active, count);
}

// The group's deformed Gaussians; `outputs` are overwritten.
static void finish_group(const DeformationPlan &plan, const float *canonical, float *outputs, const FrogDeformed &out,
                         long long start, int count) {
  const FrogDeformation &field = *plan.field;
  finish_shapes(plan, canonical, outputs, out, start, count);
  for (int v = 0; v < GROUP_SIZE; v += LANES) activate_others(field, canonical + v, outputs + v);
  give_others(field, outputs, out, start, count);
  copy(out.opacities + start, outputs + PLAYBACK_OPACITY * GROUP_SIZE, count);
}

// The same of a group that cannot be seen: as canonically, but transparent.
static void finish_unseen(const DeformationPlan &plan, const float *canonical, float *outputs, const FrogDeformed &out,
                          long long start, int count) {
  const ShapeRows rows(*plan.field);
  put_zeros(outputs + rows.scales * GROUP_SIZE, (rows.end - rows.scales) * GROUP_SIZE);
  finish_shapes(plan, canonical, outputs, out, start, count);
  give_others(*plan.field, canonical, out, start, count);
  put_zeros(out.opacities + start, count);
}

// Groups that can be seen, until there are as many as are multiplied at once.
class WaitingGroups {
  const DeformationPlan &plan_;
  const FrogDeformed &out_;
  const int end_, row_;
  const float *own_[PLAYBACK_TOGETHER];
  float *hidden_[PLAYBACK_TOGETHER], *outputs_[PLAYBACK_TOGETHER];
  long long starts_[PLAYBACK_TOGETHER];
  int count_ = 0;

  // Memory of as many groups that come next, seen or not: what is read of them and, where there are products enough to
  // ask meanwhile, written.
  Prefetcher memory_of_next() const {
    const long long start = starts_[count_ - 1] + GROUP_SIZE;
    const int gaussians = count_ * GROUP_SIZE;
    Prefetcher prefetcher;
    prefetcher.add(group_from(start), static_cast<long long>(gaussians) * row_);
    if (!plan_.field->precomputed_first_layer)
      prefetch_deformed(prefetcher, out_, start, gaussians, plan_.field->sh_deformed ? 3 * plan_.field->sh_active : 0);
    return prefetcher;
  }

 public:
  WaitingGroups(const DeformationPlan &plan, const DeformationLayout &l, const FrogDeformed &out, int end,
                float *scratch)
      : plan_(plan),
        out_(out),
        end_(end),
        row_(plan.outputs + (plan.field->precomputed_first_layer ? plan.hidden : plan.embedding)) {
    for (int g = 0; g < PLAYBACK_TOGETHER; ++g) {
      hidden_[g] = scratch + l.first + g * GROUP_SIZE * plan.hidden;
      outputs_[g] = scratch + l.columns + g * GROUP_SIZE * l.outputs;
    }
  }
  // Where the group's numbers lie.
  const float *group_from(long long start) const { return plan_.field->groups + start * row_; }
  int gaussians_from(long long start) const {
    const long long left = end_ - start;
    return left < GROUP_SIZE ? static_cast<int>(left) : static_cast<int>(GROUP_SIZE);
  }
  void add(long long start) {
    own_[count_] = group_from(start) + plan_.outputs * GROUP_SIZE;
    starts_[count_] = start;
    if (++count_ == PLAYBACK_TOGETHER) finish();
  }
  void finish() {
    if (count_ == 0) return;
    Prefetcher prefetcher = memory_of_next();
    if (count_ == PLAYBACK_TOGETHER)
      group_network<PLAYBACK_TOGETHER>(plan_, own_, prefetcher, hidden_, outputs_);
    else
      group_network<1>(plan_, own_, prefetcher, hidden_, outputs_);
    for (int g = 0; g < count_; ++g) {
      const long long start = starts_[g];
      finish_group(plan_, group_from(start), outputs_[g], out_, start, gaussians_from(start));
    }
    count_ = 0;
  }
};

static void playback(const DeformationPlan &plan, const FrogDeformed &out, int begin, int end, float *scratch) {
  const FrogDeformation &field = *plan.field;
  const DeformationLayout l = layout_of(plan);
  WaitingGroups waiting(plan, l, out, end, scratch);
  for (long long start = begin; start < end; start += GROUP_SIZE) {
    const long long group = start / GROUP_SIZE;
    const bool seen = !field.active || field.active[group];
    if (!seen && out.was_visible && out.was_visible[group] == 0) continue;
    if (out.was_visible) out.was_visible[group] = seen;
    if (seen)
      waiting.add(start);
    else
      finish_unseen(plan, waiting.group_from(start), scratch + l.result, out, start, waiting.gaussians_from(start));
  }
  waiting.finish();
}
