// The deformation field, fused: network, activations and opacity reduction for a block of Gaussians at a time, so that
// no layer is ever written out for all of them; and its gradients, for which a block's layers are computed again.

// Factor on the opacity at a change of its logit, from e = exp(-sharpness * change), and its derivative by the change
// (see model/opacity.py).
static inline float reduction_of(const FrogDeformation &field, float e, float &slope) {
  slope = 0;
  if (field.opacity_form == FROG_OPACITY_OFF || field.opacity_share == 0) return 1;
  const float s = 1 / (1 + e);
  float factor = s, by_change = field.opacity_sharpness * s * (1 - s);
  if (field.opacity_form == FROG_OPACITY_UNIT) factor = 2 * s < 1 ? 2 * s : 1, by_change = 2 * s <= 1 ? 2 * by_change : 0;
  slope = field.opacity_share * by_change;
  return (1 - field.opacity_share) + field.opacity_share * factor;
}

static inline void fill_rows(float *rows, int count, long long row_length, const float *row, long long length) {
  for (int r = 0; r < count; ++r)
    for (long long i = 0; i < length; i += LANES) store(rows + r * row_length + i, load(row + i));
}

static inline void relu(float *values, long long count) {
  for (long long i = 0; i < count; i += LANES) store(values + i, larger(load(values + i), Floats{}));
}

// Zero where the value is not a normal positive number.
static inline void relu_backward(float *gradient, const float *values, long long count) {
  for (long long i = 0; i < count; i += LANES) {
    const Floats v = load(values + i);
    store(gradient + i, keep(at_least(v, all(1.2e-38f)), load(gradient + i)));
  }
}

static inline void add_rows(const float *values, int rows, long long row_length, float *sums) {
  for (int r = 0; r < rows; ++r)
    for (long long i = 0; i < row_length; i += LANES) store(sums + i, load(sums + i) + load(values + r * row_length + i));
}

// Fills input, first, second and result of a block.
static void network_forward(const DeformationPlan &plan, const DeformationLayout &l, float *scratch, int begin, int rows) {
  const FrogDeformation &field = *plan.field;
  float *input = scratch + l.input, *first = scratch + l.first, *second = scratch + l.second, *result = scratch + l.result;
  for (int r = 0; r < rows; ++r) {
    __builtin_memcpy(input + r * l.embedding, field.embeddings + static_cast<long long>(begin + r) * plan.embedding,
                     plan.embedding * sizeof(float));
    for (long long k = plan.embedding; k < l.embedding; ++k) input[r * l.embedding + k] = 0;
  }
  fill_rows(first, rows, l.hidden, plan.shared, l.hidden);
  multiply<true>(rows, plan.embedding, static_cast<int>(l.hidden), {input, l.embedding, 1}, plan.embedding_forward, l.hidden, first, l.hidden);
  relu(first, rows * l.hidden);
  if (plan.heads) {
    const long long width = padded(plan.heads);
    for (int r = 0; r < rows; ++r)
      for (long long k = width; k < l.heads; ++k) second[r * l.heads + k] = 0;
    fill_rows(second, rows, l.heads, plan.head_bias, width);
    multiply<true>(rows, plan.hidden, static_cast<int>(width), {first, l.hidden, 1}, plan.head_forward, width, second, l.heads);
    relu(second, rows * l.heads);
  }
  const float *source = plan.heads ? second : first;
  const long long source_row = plan.heads ? l.heads : l.hidden;
  for (int b = 0; b < plan.branch_count; ++b) {
    const Branch &branch = plan.branches[b];
    const long long width = padded(branch.size);
    fill_rows(result + branch.output, rows, l.outputs, branch.bias, width);
    multiply<true>(rows, branch.inputs, static_cast<int>(width), {source + branch.source, source_row, 1}, branch.forward, width,
                   result + branch.output, l.outputs);
  }
}

// Offsets of the outputs: means 3, log_scales 3, quaternions 4, opacity logit 1, then spherical harmonics.
enum { OUT_MEANS = 0, OUT_SCALES = 3, OUT_QUATERNIONS = 6, OUT_OPACITY = 10, OUT_SH = 11 };

// The block's exponentials, EXPONENTIALS rows of DEFORM_BLOCK.
static void activate(const FrogDeformation &field, const DeformationLayout &l, float *scratch, int begin, int rows) {
  float *e = scratch + l.exponentials;
  const float *result = scratch + l.result;
  for (int r = 0; r < rows; ++r) {
    const long long i = begin + r;
    const float *y = result + r * l.outputs;
    for (int k = 0; k < 3; ++k) e[(EXP_SCALES + k) * DEFORM_BLOCK + r] = field.log_scales[3 * i + k] + y[OUT_SCALES + k];
    e[EXP_OPACITY * DEFORM_BLOCK + r] = -(field.opacity_logits[i] + y[OUT_OPACITY]);
    e[EXP_REDUCTION * DEFORM_BLOCK + r] = -field.opacity_sharpness * y[OUT_OPACITY];
  }
  for (int k = 0; k < EXPONENTIALS; ++k)
    for (int r = 0; r < rows; r += LANES) {
      float *at = e + k * DEFORM_BLOCK + r;
      store(at, exp2(larger(smaller(load(at) * LOG2E, all(120.0f)), all(-120.0f))));
    }
}

static void deform(const DeformationPlan &plan, const FrogDeformed &out, int begin, int end, float *scratch) {
  const FrogDeformation &field = *plan.field;
  const DeformationLayout l = layout_of(plan);
  for (int start = begin; start < end; start += DEFORM_BLOCK) {
    const int rows = end - start < DEFORM_BLOCK ? end - start : DEFORM_BLOCK;
    network_forward(plan, l, scratch, start, rows);
    activate(field, l, scratch, start, rows);
    for (int r = 0; r < rows; ++r) {
      const long long i = start + r;
      const float *y = scratch + l.result + r * l.outputs, *e = scratch + l.exponentials + r;
      for (int k = 0; k < 3; ++k) out.means[3 * i + k] = field.means[3 * i + k] + field.motion_unit * y[OUT_MEANS + k];
      for (int k = 0; k < 3; ++k) out.scales[3 * i + k] = e[(EXP_SCALES + k) * DEFORM_BLOCK];
      for (int k = 0; k < 4; ++k) out.quaternions[4 * i + k] = field.quaternions[4 * i + k] + y[OUT_QUATERNIONS + k];
      float slope;
      out.opacities[i] = reduction_of(field, e[EXP_REDUCTION * DEFORM_BLOCK], slope) / (1 + e[EXP_OPACITY * DEFORM_BLOCK]);
      const float *sh = field.sh + i * 3 * field.sh_count;
      float *sh_out = out.sh + i * 3 * field.sh_active;
      const int deformed = 3 * (field.sh_deformed < field.sh_active ? field.sh_deformed : field.sh_active);
      for (int k = 0; k < deformed; ++k) sh_out[k] = sh[k] + y[OUT_SH + k];
      for (int k = deformed; k < 3 * field.sh_active; ++k) sh_out[k] = sh[k];
      if (!out.changes) continue;
      for (int k = 0; k < plan.outputs; ++k) out.changes[i * plan.outputs + k] = k < 3 ? field.motion_unit * y[k] : y[k];
    }
  }
}

// Gradients through the activations of Gaussian i: of its canonical attributes, and of the network's outputs.
static inline void activations_backward(const FrogDeformation &field, const FrogDeformed &by, const FrogDeformationGradients &out,
                                        long long i, const float *e, float *by_y) {
  for (int k = 0; k < 3; ++k) {
    const float by_mean = by.means[3 * i + k];
    out.means[3 * i + k] = by_mean;
    by_y[OUT_MEANS + k] = field.motion_unit * by_mean;
  }
  for (int k = 0; k < 3; ++k)
    out.log_scales[3 * i + k] = by_y[OUT_SCALES + k] = by.scales[3 * i + k] * e[(EXP_SCALES + k) * DEFORM_BLOCK];
  for (int k = 0; k < 4; ++k) out.quaternions[4 * i + k] = by_y[OUT_QUATERNIONS + k] = by.quaternions[4 * i + k];
  float slope;
  const float opacity = 1 / (1 + e[EXP_OPACITY * DEFORM_BLOCK]), factor = reduction_of(field, e[EXP_REDUCTION * DEFORM_BLOCK], slope);
  const float by_logit = by.opacities[i] * factor * opacity * (1 - opacity);
  out.opacity_logits[i] = by_logit;
  by_y[OUT_OPACITY] = by_logit + by.opacities[i] * opacity * slope;
  const float *by_sh = by.sh + i * 3 * field.sh_active;
  float *sh_out = out.sh + i * 3 * field.sh_count;
  for (int k = 0; k < 3 * field.sh_active; ++k) sh_out[k] = by_sh[k];
  for (int k = 3 * field.sh_active; k < 3 * field.sh_count; ++k) sh_out[k] = 0;
  for (int k = 0; k < 3 * field.sh_deformed; ++k) by_y[OUT_SH + k] = k < 3 * field.sh_active ? by_sh[k] : 0;
}

// Gradients through the network of one block; weight gradients are added to `partial`.
static void network_backward(const DeformationPlan &plan, const DeformationLayout &l, float *scratch, int rows, float *partial) {
  float *input = scratch + l.input, *first = scratch + l.first, *second = scratch + l.second;
  float *by_first = scratch + l.by_first, *by_second = scratch + l.by_second, *by_result = scratch + l.by_result;
  const float *source = plan.heads ? second : first;
  float *by_source = plan.heads ? by_second : by_first;
  const long long source_row = plan.heads ? l.heads : l.hidden;
  add_rows(by_result, rows, l.outputs, partial + l.bias_output);
  // In order: a head's padding is overwritten by the next head.
  for (int b = 0; b < plan.branch_count; ++b) {
    const Branch &branch = plan.branches[b];
    const int width = static_cast<int>(padded(branch.inputs));
    multiply<false>(rows, branch.size, width, {by_result + branch.output, l.outputs, 1}, branch.backward, width,
                    by_source + branch.source, source_row);
    multiply<true>(branch.size, rows, width, {by_result + branch.output, 1, l.outputs}, source + branch.source, source_row,
                   partial + l.weight_output + branch.output * source_row, source_row);
  }
  if (plan.heads) {
    for (int r = 0; r < rows; ++r)  // what lies beyond the last head is no unit
      for (long long k = plan.heads; k < l.heads; ++k) by_second[r * l.heads + k] = 0;
    relu_backward(by_second, second, rows * l.heads);
    add_rows(by_second, rows, l.heads, partial + l.bias_head);
    multiply<false>(rows, plan.heads, static_cast<int>(l.hidden), {by_second, l.heads, 1}, plan.head_backward, l.hidden, by_first, l.hidden);
    multiply<true>(plan.heads, rows, static_cast<int>(l.hidden), {by_second, 1, l.heads}, first, l.hidden, partial + l.weight_head, l.hidden);
  }
  relu_backward(by_first, first, rows * l.hidden);
  add_rows(by_first, rows, l.hidden, partial + l.weight_shared);
  multiply<true>(plan.hidden, rows, static_cast<int>(l.embedding), {by_first, 1, l.hidden}, input, l.embedding,
                 partial + l.weight_embedding, l.embedding);
  multiply<false>(rows, plan.hidden, static_cast<int>(l.embedding), {by_first, l.hidden, 1}, plan.embedding_backward, l.embedding,
                  scratch + l.by_input, l.embedding);
}

static void deform_backward(const DeformationPlan &plan, const FrogDeformed &by, const FrogDeformationGradients &out,
                            int begin, int end, float *scratch, float *partial) {
  const FrogDeformation &field = *plan.field;
  const DeformationLayout l = layout_of(plan);
  for (int start = begin; start < end; start += DEFORM_BLOCK) {
    const int rows = end - start < DEFORM_BLOCK ? end - start : DEFORM_BLOCK;
    network_forward(plan, l, scratch, start, rows);
    activate(field, l, scratch, start, rows);
    for (int r = 0; r < rows; ++r) {
      float *by_y = scratch + l.by_result + r * l.outputs;
      for (long long k = plan.outputs; k < l.outputs; ++k) by_y[k] = 0;
      activations_backward(field, by, out, start + r, scratch + l.exponentials + r, by_y);
    }
    network_backward(plan, l, scratch, rows, partial);
    for (int r = 0; r < rows; ++r)
      __builtin_memcpy(out.embeddings + static_cast<long long>(start + r) * plan.embedding, scratch + l.by_input + r * l.embedding,
                       plan.embedding * sizeof(float));
  }
}
