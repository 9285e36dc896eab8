// The deformation field over all Gaussians: packs the weights, shares blocks out to the threads, and adds the chunks'
// weight gradients in a fixed order.
#include "deformation.h"

#include <algorithm>

#include "buffer.h"
#include "thread_pool.h"

namespace frog {
namespace {

// (rows, columns) to rows of padded length; `transposed` swaps the two first. What pads is zero.
const float *pack(std::vector<std::vector<float>> &memory, const float *from, long long rows, long long columns, bool transposed) {
  const long long out_rows = transposed ? columns : rows, out_columns = transposed ? rows : columns;
  memory.emplace_back(static_cast<size_t>(out_rows * padded(out_columns)), 0.0f);
  float *to = memory.back().data();
  for (long long r = 0; r < rows; ++r)
    for (long long c = 0; c < columns; ++c)
      to[transposed ? c * padded(rows) + r : r * padded(columns) + c] = from[r * columns + c];
  return to;
}

struct Packed {
  std::vector<std::vector<float>> memory;
  DeformationPlan plan{};
};

Packed plan_of(const FrogDeformation &field, bool backward) {
  Packed packed;
  DeformationPlan &plan = packed.plan;
  plan.field = &field;
  plan.embedding = field.embedding_size, plan.hidden = field.hidden_width;
  plan.outputs = 11 + 3 * field.sh_deformed;
  const int sizes[MAX_BRANCHES] = {3, 3, 4, 1, 3 * field.sh_deformed};
  plan.branch_count = field.head_width ? (field.sh_deformed ? 5 : 4) : 1;
  plan.heads = field.head_width ? field.head_width * plan.branch_count : 0;
  packed.memory.reserve(6 + 3 * MAX_BRANCHES);
  plan.shared = pack(packed.memory, field.shared, 1, plan.hidden, false);
  plan.embedding_forward = pack(packed.memory, field.embedding_weight, plan.hidden, plan.embedding, true);
  if (backward) plan.embedding_backward = pack(packed.memory, field.embedding_weight, plan.hidden, plan.embedding, false);
  if (plan.heads) {
    plan.head_bias = pack(packed.memory, field.head_bias, 1, plan.heads, false);
    plan.head_forward = pack(packed.memory, field.head_weight, plan.heads, plan.hidden, true);
    if (backward) plan.head_backward = pack(packed.memory, field.head_weight, plan.heads, plan.hidden, false);
  }
  int output = 0;
  for (int b = 0; b < plan.branch_count; ++b) {
    Branch &branch = plan.branches[b];
    branch.inputs = plan.heads ? field.head_width : plan.hidden;
    branch.source = plan.heads ? b * field.head_width : 0;
    branch.output = output;
    branch.size = plan.heads ? sizes[b] : plan.outputs;
    const float *weight = field.output_weight + static_cast<long long>(output) * branch.inputs;
    branch.forward = pack(packed.memory, weight, branch.size, branch.inputs, true);
    if (backward) branch.backward = pack(packed.memory, weight, branch.size, branch.inputs, false);
    branch.bias = pack(packed.memory, field.output_bias + output, 1, branch.size, false);
    output += branch.size;
  }
  return packed;
}

void unpack(const float *from, long long rows, long long row_length, long long columns, float *to) {
  for (long long r = 0; r < rows; ++r) std::copy_n(from + r * row_length, columns, to + r * columns);
}

}  // namespace

void deform(const Kernels &kernels, const FrogDeformation &field, const FrogDeformed &result) {
  const Packed packed = plan_of(field, false);
  const DeformationLayout layout = layout_of(packed.plan);
  parallel_for(field.count, DEFORM_CHUNK, [&](int begin, int end) {
    Buffer<float> scratch;
    kernels.deform(packed.plan, result, begin, end, scratch.resize(layout.scratch));
  });
}

void deform_backward(const Kernels &kernels, const FrogDeformation &field, const FrogDeformed &by,
                     const FrogDeformationGradients &result) {
  const Packed packed = plan_of(field, true);
  const DeformationPlan &plan = packed.plan;
  const DeformationLayout l = layout_of(plan);
  const long long chunks = (field.count + DEFORM_CHUNK - 1) / DEFORM_CHUNK;
  Buffer<float> partials;
  partials.resize(std::max(1ll, chunks) * l.partial);
  std::fill_n(partials.data(), l.partial, 0.0f);  // the sum, where there is no chunk
  parallel_for(field.count, DEFORM_CHUNK, [&](int begin, int end) {
    Buffer<float> scratch;
    float *mine = partials.data() + begin / DEFORM_CHUNK * l.partial;
    std::fill_n(mine, l.partial, 0.0f);
    kernels.deform_backward(plan, by, result, begin, end, scratch.resize(l.scratch), mine);
  });
  float *sum = partials.data();
  for (long long chunk = 1; chunk < chunks; ++chunk)
    for (long long k = 0; k < l.partial; ++k) sum[k] += partials[chunk * l.partial + k];
  unpack(sum + l.weight_embedding, plan.hidden, l.embedding, plan.embedding, result.embedding_weight);
  std::copy_n(sum + l.weight_shared, plan.hidden, result.shared);
  if (plan.heads) {
    unpack(sum + l.weight_head, plan.heads, l.hidden, plan.hidden, result.head_weight);
    std::copy_n(sum + l.bias_head, plan.heads, result.head_bias);
  }
  unpack(sum + l.weight_output, plan.outputs, plan.heads ? l.heads : l.hidden, plan.branches[0].inputs, result.output_weight);
  std::copy_n(sum + l.bias_output, plan.outputs, result.output_bias);
}

}  // namespace frog
