// What becomes of the deformation network's outputs: activations, opacity reduction, the deformed attributes; and their
// gradients. Gaussians' numbers are handled in fours, which overlap the next Gaussian's where there are three: what is
// stored over it is written again when its turn comes, and the last one of a block goes number by number.

typedef float Quad __attribute__((vector_size(16)));
static inline Quad load_4(const float *from) {
  Quad v;
  __builtin_memcpy(&v, from, sizeof v);
  return v;
}
static inline void store_4(float *to, Quad v) { __builtin_memcpy(to, &v, sizeof v); }
static inline Quad load_3(const float *from, bool last) {
  return last ? Quad{from[0], from[1], from[2]} : load_4(from);
}
static inline void store_3(float *to, Quad v, bool last) {
  if (!last) return store_4(to, v);
  for (int k = 0; k < 3; ++k) to[k] = v[k];
}

// Offsets of the outputs: means 3, log_scales 3, quaternions 4, opacity logit 1, then spherical harmonics.
enum { OUT_MEANS = 0, OUT_SCALES = 3, OUT_QUATERNIONS = 6, OUT_OPACITY = 10, OUT_SH = 11 };

// to = a + b, or a.
static inline void add(float *to, const float *a, const float *b, long long count) {
  long long k = 0;
  for (; k + 4 <= count; k += 4) store_4(to + k, load_4(a + k) + load_4(b + k));
  for (; k < count; ++k) to[k] = a[k] + b[k];
}
static inline void copy(float *to, const float *a, long long count) {
  long long k = 0;
  for (; k + LANES <= count; k += LANES) store(to + k, load(a + k));
  for (; k + 4 <= count; k += 4) store_4(to + k, load_4(a + k));
  for (; k < count; ++k) to[k] = a[k];
}

static inline bool reduces(const FrogDeformation &field) {
  return field.opacity_form != FROG_OPACITY_OFF && field.opacity_share != 0;
}

// Factor on the opacity at a change of its logit, from e = exp(-sharpness * change) (see model/opacity.py).
static inline Floats reduction(const FrogDeformation &field, Floats e) {
  Floats factor = 1.0f / (1.0f + e);
  if (field.opacity_form == FROG_OPACITY_UNIT) factor = smaller(2.0f * factor, all(1.0f));
  return (1 - field.opacity_share) + field.opacity_share * factor;
}
// Its derivative by the change.
static inline Floats reduction_slope(const FrogDeformation &field, Floats e) {
  const Floats s = 1.0f / (1.0f + e), by_change = field.opacity_share * field.opacity_sharpness * s * (1.0f - s);
  if (field.opacity_form == FROG_OPACITY_PAPER) return by_change;
  return keep(at_least(all(0.5f), s), 2.0f * by_change);
}

static inline Floats exponential(Floats x) { return exp2(larger(smaller(x * LOG2E, all(120.0f)), all(-120.0f))); }
static inline void exponentials(float *values, long long count) {
  for (long long i = 0; i < count; i += LANES) store(values + i, exponential(load(values + i)));
}

// The block's exponentials: its scales (rows, 3), and those in the sigmoids of its opacities and of their reduction.
static void activate(const FrogDeformation &field, const DeformationLayout &l, float *scratch, int begin, int rows) {
  float *scales = scratch + l.scales, *opacities = scratch + l.opacities, *reductions = scratch + l.reductions;
  const float *log_scales = field.log_scales + 3ll * begin, *logits = field.opacity_logits + begin;
  const float *y = scratch + l.result;
  for (int r = 0; r < rows; ++r, y += l.outputs) {
    store_4(scales + 3 * r, load_3(log_scales + 3 * r, r == rows - 1) + load_4(y + OUT_SCALES));
    opacities[r] = -(logits[r] + y[OUT_OPACITY]);
    reductions[r] = -field.opacity_sharpness * y[OUT_OPACITY];
  }
  exponentials(scales, 3 * rows);
  exponentials(opacities, rows);
  if (!reduces(field)) return;
  if (begin < field.num_dynamic)
    exponentials(reductions, rows);
  else  // at rest: the factor is one in every form
    for (int r = 0; r < rows; ++r) reductions[r] = 0;
}

// Turns the exponentials in `opacities` into the opacities themselves.
static void finish_opacities(const FrogDeformation &field, const DeformationLayout &l, float *scratch, int rows) {
  float *opacities = scratch + l.opacities;
  const float *reductions = scratch + l.reductions;
  for (int r = 0; r < rows; r += LANES) {
    const Floats factor = reduces(field) ? reduction(field, load(reductions + r)) : all(1.0f);
    store(opacities + r, factor / (1.0f + load(opacities + r)));
  }
}

static void finish_quaternions(const FrogDeformation &field, const DeformationLayout &l, float *scratch,
                               float *quaternions, int begin, int rows) {
  const float *from = field.quaternions + 4ll * begin, *y = scratch + l.result + OUT_QUATERNIONS;
  float *lengths = scratch + l.lengths;
  for (int r = 0; r < rows; ++r, y += l.outputs) {
    const Quad q = load_4(from + 4 * r) + load_4(y), squares = q * q;
    store_4(quaternions + 4 * r, q);
    lengths[r] = (squares[0] + squares[1]) + (squares[2] + squares[3]);
  }
  if (!field.unit_quaternions) return;
  for (int r = 0; r < rows; ++r) {
    const float length = __builtin_sqrtf(lengths[r]);
    lengths[r] = 1 / (length > 1e-12f ? length : 1e-12f);
  }
  for (int r = 0; r < rows; ++r) store_4(quaternions + 4 * r, load_4(quaternions + 4 * r) * lengths[r]);
}

// The deformed attributes of a block, from its outputs and exponentials.
static void finish(const DeformationPlan &plan, const DeformationLayout &l, float *scratch, const FrogDeformed &out,
                   int begin, int rows) {
  const FrogDeformation &field = *plan.field;
  const float *means = field.means + 3ll * begin, *y = scratch + l.result;
  float *means_out = out.means + 3ll * begin;
  for (int r = 0; r < rows; ++r, y += l.outputs) {
    const bool last = r == rows - 1;
    store_3(means_out + 3 * r, load_3(means + 3 * r, last) + field.motion_unit * load_4(y + OUT_MEANS), last);
  }
  copy(out.scales + 3ll * begin, scratch + l.scales, 3 * rows);
  finish_opacities(field, l, scratch, rows);
  copy(out.opacities + begin, scratch + l.opacities, rows);
  finish_quaternions(field, l, scratch, out.quaternions + 4ll * begin, begin, rows);
  const int there = 3 * (field.sh_count < field.sh_active ? field.sh_count : field.sh_active);
  const int deformed = 3 * field.sh_deformed < there ? 3 * field.sh_deformed : there;
  const float *sh = field.sh + 3ll * field.sh_count * begin;
  float *sh_out = out.sh + 3ll * field.sh_active * begin;
  y = scratch + l.result + OUT_SH;
  for (int r = 0; r < rows; ++r, sh += 3 * field.sh_count, sh_out += 3 * field.sh_active, y += l.outputs) {
    add(sh_out, sh, y, deformed);
    copy(sh_out + deformed, sh + deformed, there - deformed);
  }
  if (!out.changes || begin >= field.num_dynamic) return;
  y = scratch + l.result;
  float *changes = out.changes + static_cast<long long>(plan.outputs) * begin;
  for (int r = 0; r < rows; ++r, changes += plan.outputs, y += l.outputs) {
    copy(changes, y, plan.outputs);
    for (int k = 0; k < 3; ++k) changes[OUT_MEANS + k] *= field.motion_unit;
  }
}

// Gradients of a block's opacities, in place: those of its logits come to `lengths`, of the network's outputs to
// `reductions`.
static void opacities_backward(const FrogDeformation &field, const DeformationLayout &l, float *scratch,
                               const float *by_opacities, int rows) {
  float *by = scratch + l.lengths, *reductions = scratch + l.reductions;
  copy(by, by_opacities, rows);
  for (int r = 0; r < rows; r += LANES) {
    const Floats e = load(reductions + r), opacity = 1.0f / (1.0f + load(scratch + l.opacities + r));
    const Floats factor = reduces(field) ? reduction(field, e) : all(1.0f);
    const Floats by_opacity = load(by + r) * opacity, by_logit = by_opacity * factor * (1.0f - opacity);
    store(by + r, by_logit);
    store(reductions + r, reduces(field) ? by_logit + by_opacity * reduction_slope(field, e) : by_logit);
  }
}

// Gradients through the activations of a block: of its canonical attributes, and of the network's outputs.
static void activations_backward(const DeformationPlan &plan, const DeformationLayout &l, float *scratch,
                                 const FrogDeformed &by, const FrogDeformationGradients &out, int begin, int rows) {
  const FrogDeformation &field = *plan.field;
  const int active = 3 * field.sh_active, stored = 3 * field.sh_count, deformed = 3 * field.sh_deformed;
  const int both = deformed < active ? deformed : active;
  opacities_backward(field, l, scratch, by.opacities + begin, rows);
  copy(out.opacity_logits + begin, scratch + l.lengths, rows);
  for (int r = 0; r < rows; ++r) {
    const long long i = begin + r;
    const bool last = r == rows - 1;
    float *by_y = scratch + l.by_result + r * l.outputs;
    const Quad by_mean = load_3(by.means + 3 * i, last), by_quaternion = load_4(by.quaternions + 4 * i);
    const Quad by_scale = load_3(by.scales + 3 * i, last) * load_4(scratch + l.scales + 3 * r);
    store_3(out.means + 3 * i, by_mean, last);
    store_3(out.log_scales + 3 * i, by_scale, last);
    store_4(out.quaternions + 4 * i, by_quaternion);
    store_4(by_y + OUT_MEANS, field.motion_unit * by_mean);
    store_4(by_y + OUT_SCALES, by_scale);
    store_4(by_y + OUT_QUATERNIONS, by_quaternion);
    by_y[OUT_OPACITY] = scratch[l.reductions + r];
    const float *by_sh = by.sh + i * active;
    float *sh_out = out.sh + i * stored;
    copy(sh_out, by_sh, active);
    for (int k = active; k < stored; ++k) sh_out[k] = 0;
    copy(by_y + OUT_SH, by_sh, both);
    for (int k = both; k < deformed; ++k) by_y[OUT_SH + k] = 0;
    for (long long k = plan.outputs; k < l.outputs; ++k) by_y[k] = 0;
  }
}
