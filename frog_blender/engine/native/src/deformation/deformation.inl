// The deformation field, fused: network, activations and opacity reduction for a block of Gaussians at a time, so that
// no layer is ever written out for all of them; and its gradients, for which a block's layers are computed again.

// Zero where the value is not a normal positive number.
static inline void relu_backward(float *gradient, const float *values, long long count) {
  for (long long i = 0; i < count; i += LANES) {
    const Floats v = load(values + i);
    store(gradient + i, keep(at_least(v, all(1.2e-38f)), load(gradient + i)));
  }
}

static inline void add_rows(const float *values, int rows, long long row_length, float *sums) {
  for (int r = 0; r < rows; ++r)
    for (long long i = 0; i < row_length; i += LANES)
      store(sums + i, load(sums + i) + load(values + r * row_length + i));
}

static inline const float *embeddings_of(const DeformationPlan &plan, int begin) {
  return plan.field->embeddings + static_cast<long long>(begin) * plan.embedding;
}

// What a block reads and writes, embeddings first.
static Prefetcher memory_of_block(const DeformationPlan &plan, const FrogDeformed &out, long long begin, int rows) {
  const FrogDeformation &field = *plan.field;
  Prefetcher prefetcher;
  const bool moves = begin < field.num_dynamic;
  if (moves) prefetcher.add(embeddings_of(plan, static_cast<int>(begin)), plan.embedding * rows);
  prefetcher.add(field.means + 3 * begin, 3 * rows);
  prefetcher.add(field.log_scales + 3 * begin, 3 * rows);
  prefetcher.add(field.quaternions + 4 * begin, 4 * rows);
  prefetcher.add(field.opacity_logits + begin, rows);
  prefetcher.add(field.sh + 3 * field.sh_count * begin, 3 * field.sh_count * rows);
  prefetch_deformed(prefetcher, out, begin, rows, 3 * field.sh_active);
  if (out.changes && moves) prefetcher.add(out.changes + plan.outputs * begin, plan.outputs * rows);
  return prefetcher;
}

// Fills first, second and result of a block.
static void network_forward(const DeformationPlan &plan, const DeformationLayout &l, float *scratch, int begin,
                            int rows, Prefetcher prefetcher) {
  float *first = scratch + l.first, *second = scratch + l.second, *result = scratch + l.result;
  multiply<ROW, true>(rows, plan.embedding, static_cast<int>(l.first_row),
                      {embeddings_of(plan, begin), plan.embedding, 1}, packed(plan.embedding_forward, plan.embedding),
                      first, l.first_row, plan.shared, prefetcher);
  const int width = static_cast<int>(padded(plan.heads));
  for (int n = 0; plan.heads && n < plan.networks; ++n)
    multiply<ROW, true>(rows, plan.hidden, width, {first + n * l.hidden, l.first_row, 1},
                        packed(plan.head_forward[n], plan.hidden), second + n * l.heads, l.second_row,
                        plan.head_bias + n * width);
  const float *source = plan.heads ? second : first;
  const long long source_row = plan.heads ? l.second_row : l.first_row;
  // In order: what pads a branch is written again by the next one, and the second network adds zeros there.
  for (int b = 0; b < plan.branch_count; ++b) {
    const Branch &branch = plan.branches[b];
    const int columns = (branch.size + LANES - 1) / LANES * LANES;
    const MatrixView a{source + branch.network * l.heads + branch.source, source_row, 1};
    const PanelView weights = packed(branch.forward, branch.inputs);
    float *to = result + branch.output;
    if (branch.network == 0)
      multiply<ROW>(rows, branch.inputs, columns, a, weights, to, l.outputs, plan.output_bias + branch.output);
    else
      multiply<SUM>(rows, branch.inputs, columns, a, weights, to, l.outputs);
  }
}

// Static Gaussians lie behind the dynamic ones; a range has one kind only.
static inline bool is_static(const DeformationPlan &plan, int begin) { return begin >= plan.field->num_dynamic; }

static void no_change(const DeformationLayout &l, float *scratch, int rows) {
  for (long long k = 0; k < rows * l.outputs; ++k) scratch[l.result + k] = 0;
}

static void deform(const DeformationPlan &plan, const FrogDeformed &out, int begin, int end, float *scratch) {
  const DeformationLayout l = layout_of(plan);
  for (int start = begin; start < end; start += DEFORM_BLOCK) {
    const int rows = end - start < DEFORM_BLOCK ? end - start : DEFORM_BLOCK;
    Prefetcher prefetcher = memory_of_block(plan, out, start, rows);
    if (is_static(plan, start)) {
      prefetcher.finish();
      no_change(l, scratch, rows);
    } else
      network_forward(plan, l, scratch, start, rows, prefetcher);
    activate(*plan.field, l, scratch, start, rows);
    finish(plan, l, scratch, out, start, rows);
  }
}

// Gradients through the network of one block; weight gradients are added to `partial`.
static void network_backward(const DeformationPlan &plan, const DeformationLayout &l, float *scratch, int begin,
                             int rows, float *partial) {
  float *input = scratch + l.input, *first = scratch + l.first, *second = scratch + l.second;
  float *by_first = scratch + l.by_first, *by_second = scratch + l.by_second, *by_result = scratch + l.by_result;
  const float *source = plan.heads ? second : first;
  float *by_source = plan.heads ? by_second : by_first;
  const long long source_row = plan.heads ? l.second_row : l.first_row;
  add_rows(by_result, rows, l.outputs, partial + l.bias_output);
  // In order: a head's padding is overwritten by the next head.
  for (int b = 0; b < plan.branch_count; ++b) {
    const Branch &branch = plan.branches[b];
    const int width = static_cast<int>(padded(branch.inputs));
    const long long at = branch.network * l.heads + branch.source;
    const float *by = by_result + branch.output;
    float *weight = partial + l.weight_output + branch.output * l.weight_output_row + branch.network * width;
    multiply<ZERO>(rows, branch.size, width, {by, l.outputs, 1}, packed(branch.backward, branch.size), by_source + at,
                   source_row);
    multiply<SUM>(branch.size, rows, width, {by, 1, l.outputs}, plain(source + at, source_row), weight,
                  l.weight_output_row);
  }
  for (int n = 0; plan.heads && n < plan.networks; ++n) {
    float *part = by_second + n * l.heads;
    for (int r = 0; r < rows; ++r)  // what lies beyond the last head is no unit
      for (long long k = plan.heads; k < l.heads; ++k) part[r * source_row + k] = 0;
  }
  if (plan.heads) {
    relu_backward(by_second, second, rows * source_row);
    add_rows(by_second, rows, source_row, partial + l.bias_head);
  }
  const int hidden = static_cast<int>(l.hidden);
  for (int n = 0; plan.heads && n < plan.networks; ++n) {
    const float *part = by_second + n * l.heads;
    float *weight = partial + l.weight_head + static_cast<long long>(n) * plan.heads * hidden;
    multiply<ZERO>(rows, plan.heads, hidden, {part, source_row, 1}, packed(plan.head_backward[n], plan.heads),
                   by_first + n * hidden, l.first_row);
    multiply<SUM>(plan.heads, rows, hidden, {part, 1, source_row}, plain(first + n * hidden, l.first_row), weight,
                  hidden);
  }
  relu_backward(by_first, first, rows * l.first_row);
  add_rows(by_first, rows, l.first_row, partial + l.weight_shared);
  for (int r = 0; r < rows; ++r) {  // as whole vectors
    float *row = input + r * l.embedding;
    copy(row, embeddings_of(plan, begin + r), plan.embedding);
    for (long long k = plan.embedding; k < l.embedding; ++k) row[k] = 0;
  }
  const int units = static_cast<int>(l.first_row), embedding = static_cast<int>(l.embedding);
  multiply<SUM>(units, rows, embedding, {by_first, 1, l.first_row}, plain(input, l.embedding),
                partial + l.weight_embedding, l.embedding);
  multiply<ZERO>(rows, units, embedding, {by_first, l.first_row, 1}, packed(plan.embedding_backward, units),
                 scratch + l.by_input, l.embedding);
}

// What the backward pass of a block reads and writes, in that order.
static Prefetcher memory_of_backward(const DeformationPlan &plan, const FrogDeformed &by,
                                     const FrogDeformationGradients &out, long long begin, int rows) {
  const FrogDeformation &field = *plan.field;
  Prefetcher prefetcher;
  prefetcher.add(embeddings_of(plan, static_cast<int>(begin)), plan.embedding * rows);
  prefetcher.add(field.log_scales + 3 * begin, 3 * rows);
  prefetcher.add(field.opacity_logits + begin, rows);
  prefetch_deformed(prefetcher, by, begin, rows, 3 * field.sh_active);
  prefetcher.add(out.means + 3 * begin, 3 * rows);
  prefetcher.add(out.log_scales + 3 * begin, 3 * rows);
  prefetcher.add(out.quaternions + 4 * begin, 4 * rows);
  prefetcher.add(out.opacity_logits + begin, rows);
  prefetcher.add(out.sh + 3 * field.sh_count * begin, 3 * field.sh_count * rows);
  prefetcher.add(out.embeddings + plan.embedding * begin, plan.embedding * rows);
  return prefetcher;
}

static void deform_backward(const DeformationPlan &plan, const FrogDeformed &by, const FrogDeformationGradients &out,
                            int begin, int end, float *scratch, float *partial) {
  const DeformationLayout l = layout_of(plan);
  for (int start = begin; start < end; start += DEFORM_BLOCK) {
    const int rows = end - start < DEFORM_BLOCK ? end - start : DEFORM_BLOCK;
    if (is_static(plan, start))
      no_change(l, scratch, rows);
    else
      network_forward(plan, l, scratch, start, rows, memory_of_backward(plan, by, out, start, rows));
    activate(*plan.field, l, scratch, start, rows);
    activations_backward(plan, l, scratch, by, out, start, rows);
    if (is_static(plan, start)) continue;
    network_backward(plan, l, scratch, start, rows, partial);
    for (int r = 0; r < rows; ++r)
      copy(out.embeddings + static_cast<long long>(start + r) * plan.embedding, scratch + l.by_input + r * l.embedding,
           plan.embedding);
  }
}
