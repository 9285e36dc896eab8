// The deformation network's weights, packed and padded as its kernels read them.
#include "deformation/plan.h"

#include <algorithm>

namespace frog {
namespace {

float *zeros(Memory &memory, long long count) { return memory.emplace_back(static_cast<size_t>(count), 0.0f).data(); }

// `count` rows of `length` numbers to rows of padded length. What pads is zero.
float *pad(Memory &memory, const float *from, int count, int length) {
  float *to = zeros(memory, count * padded(length));
  for (long long r = 0; r < count; ++r) std::copy_n(from + r * length, length, to + r * padded(length));
  return to;
}

// A matrix of `inner` rows in panels of DEFORM_PAD columns (see gemm.inl).
struct Panels {
  float *data;
  long long inner;

  float &at(int row, int column) const {
    return data[(column / DEFORM_PAD * inner + row) * DEFORM_PAD + column % DEFORM_PAD];
  }
};

Panels panels(Memory &memory, long long rows, long long columns) {
  return {zeros(memory, rows * padded(columns)), rows};
}

// A layer's weights: (inputs, units) and, where there is a backward pass, (units, inputs).
struct Layer {
  Panels forward, back{nullptr, 0};

  Layer(Memory &memory, int inputs, int units, bool backward) : forward(panels(memory, inputs, units)) {
    if (backward) back = panels(memory, units, inputs);
  }
  // `count` units from `first` on, whose weights begin `row` numbers apart.
  void put(const float *weights, int count, long long row, int first) const {
    for (int u = 0; u < count; ++u)
      for (int i = 0; i < forward.inner; ++i) {
        forward.at(i, first + u) = weights[u * row + i];
        if (back.data) back.at(first + u, i) = weights[u * row + i];
      }
  }
};

// Playback's weights come as they are read; what of the first layer depends on time is put together here.
void plan_groups(Packed &packed) {
  DeformationPlan &plan = packed.plan;
  const FrogDeformation &field = *plan.field;
  const long long row = padded(plan.hidden);
  float *shared = packed.memory.emplace_back(field.shared, field.shared + row).data();
  plan.shared = shared;
  plan.output_rows = field.output_weight;
  plan.output_bias = field.output_bias;
  plan.embedding_rows = field.embedding_weight;
  float *weights = nullptr;
  if (field.modulation_weight) plan.embedding_rows = weights = zeros(packed.memory, field.embedding_size * row);
  for (int n = 0; n < (field.temporal ? field.networks : 0); ++n) {
    const float *temporal = field.temporal + n * field.temporal_size;
    const long long begin = n * field.hidden_width, end = begin + field.hidden_width;
    for (int t = 0; t < field.temporal_size; ++t)
      for (long long u = begin; u < end; ++u) shared[u] += field.temporal_weight[t * row + u] * temporal[t];
    for (int k = 0; k < (weights ? field.embedding_size : 0); ++k)
      for (long long u = k * row + begin; u < k * row + end; ++u)
        weights[u] = field.embedding_weight[u] + field.modulation_weight[u] * (temporal[k] - 1);
  }
}

// The output layer's parts: one for each head that has a layer of its own, else one for everything.
struct Heads {
  int count = 1, sizes[5];

  explicit Heads(const FrogDeformation &field) : sizes{3, 3, 4, 1, 3 * field.sh_deformed} {
    if (field.head_width)
      count = field.sh_deformed ? 5 : 4;
    else
      sizes[0] = OUT_SH + sizes[4];
  }
};

void plan_first(Packed &packed, bool backward) {
  DeformationPlan &plan = packed.plan;
  const FrogDeformation &field = *plan.field;
  const int row = static_cast<int>(padded(plan.hidden)), parts = plan.networks;
  plan.shared = pad(packed.memory, field.shared, parts, plan.hidden);
  const Layer layer(packed.memory, plan.embedding, parts * row, backward);
  plan.embedding_forward = layer.forward.data;
  plan.embedding_backward = layer.back.data;
  for (int n = 0; n < parts; ++n) {
    const float *weight = field.embedding_weight + static_cast<long long>(n) * plan.hidden * plan.embedding;
    layer.put(weight, plan.hidden, plan.embedding, n * row);
  }
}

void plan_heads(Packed &packed, const Heads &heads, bool backward) {
  DeformationPlan &plan = packed.plan;
  const FrogDeformation &field = *plan.field;
  const int width = field.head_width;
  float *bias = zeros(packed.memory, plan.networks * padded(plan.heads));
  plan.head_bias = bias;
  for (int n = 0; n < plan.networks; ++n) {
    const Layer layer(packed.memory, plan.hidden, plan.heads, backward);
    plan.head_forward[n] = layer.forward.data;
    plan.head_backward[n] = layer.back.data;
    for (int head = 0; head < heads.count; ++head) {
      const int first = head * width;
      const long long unit = static_cast<long long>(n * heads.count + head) * width;
      layer.put(field.head_weight + unit * plan.hidden, width, plan.hidden, first);
      std::copy_n(field.head_bias + unit, width, bias + n * padded(plan.heads) + first);
    }
  }
}

void plan_outputs(Packed &packed, const Heads &heads, bool backward) {
  DeformationPlan &plan = packed.plan;
  const FrogDeformation &field = *plan.field;
  const int inputs = field.head_width ? field.head_width : plan.hidden;
  // Padded as the outputs' rows are: a branch's padding may reach over the last one.
  float *bias = zeros(packed.memory, padded(plan.outputs) + DEFORM_PAD);
  plan.output_bias = bias;
  std::copy_n(field.output_bias, plan.outputs, bias);
  for (int n = 0; n < plan.networks; ++n) {
    int output = 0;
    for (int head = 0; head < heads.count; ++head) {
      const int size = heads.sizes[head];
      const long long length = static_cast<long long>(plan.networks) * inputs;
      const Layer layer(packed.memory, inputs, size, backward);
      layer.put(field.output_weight + output * length + n * inputs, size, length, 0);
      plan.branches[plan.branch_count++] = {n,      head * inputs, inputs, output, size, layer.forward.data,
                                            layer.back.data};
      output += size;
    }
  }
}

}  // namespace

Packed plan_of(const FrogDeformation &field, bool backward) {
  Packed packed;
  DeformationPlan &plan = packed.plan;
  plan.field = &field;
  plan.networks = field.head_width ? field.networks : 1;
  plan.embedding = field.embedding_size;
  plan.hidden = field.head_width ? field.hidden_width : field.networks * field.hidden_width;
  const Heads heads(field);
  plan.heads = field.head_width ? field.head_width * heads.count : 0;
  plan.outputs = OUT_SH + 3 * field.sh_deformed;
  if (field.groups) {
    plan_groups(packed);
    return packed;
  }
  plan_first(packed, backward);
  if (plan.heads) plan_heads(packed, heads, backward);
  plan_outputs(packed, heads, backward);
  return packed;
}

}  // namespace frog
