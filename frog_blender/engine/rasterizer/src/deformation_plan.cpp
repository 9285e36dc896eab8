// The deformation network's weights, packed and padded as its kernels read them.
#include "deformation_plan.h"

#include <algorithm>

namespace frog {
namespace {

// `count` rows of `length` numbers to rows of padded length. What pads is zero.
float *pad(Memory &memory, const float *from, int count, int length) {
  memory.emplace_back(static_cast<size_t>(count * padded(length)), 0.0f);
  float *to = memory.back().data();
  for (long long r = 0; r < count; ++r) std::copy_n(from + r * length, length, to + r * padded(length));
  return to;
}

// A matrix of `inner` rows in panels of DEFORM_PAD columns (see gemm.inl).
struct Panels {
  float *data;
  int inner;

  // Elements (r, c) from from[r * by_row + c * by_column].
  void put(const float *from, int rows, int columns, long long by_row, long long by_column, int first_row, int first_column) const {
    for (int r = 0; r < rows; ++r)
      for (int c = 0; c < columns; ++c) {
        const int row = first_row + r, column = first_column + c;
        const long long panel = column / DEFORM_PAD;
        data[(panel * inner + row) * DEFORM_PAD + column % DEFORM_PAD] = from[r * by_row + c * by_column];
      }
  }
};

Panels panels(Memory &memory, long long rows, long long columns) {
  memory.emplace_back(static_cast<size_t>(rows * padded(columns)), 0.0f);
  return {memory.back().data(), static_cast<int>(rows)};
}

// A matrix (rows, columns) whose rows are `length` apart, and its transpose.
const float *pack(Memory &memory, const float *from, int rows, int columns, long long length) {
  const Panels to = panels(memory, rows, columns);
  to.put(from, rows, columns, length, 1, 0, 0);
  return to.data;
}
const float *pack_transposed(Memory &memory, const float *from, int rows, int columns, long long length) {
  const Panels to = panels(memory, columns, rows);
  to.put(from, columns, rows, 1, length, 0, 0);
  return to.data;
}

// (columns, padded(rows)) of a matrix (rows, columns), whose row r comes from row row_of(r).
template <class RowOf>
const float *turned(Memory &memory, const float *from, int rows, int columns, const RowOf &row_of) {
  memory.emplace_back(static_cast<size_t>(columns * padded(rows)), 0.0f);
  float *to = memory.back().data();
  for (int r = 0; r < rows; ++r)
    for (long long c = 0; c < columns; ++c) to[c * padded(rows) + r] = from[row_of(r) * static_cast<long long>(columns) + c];
  return to;
}

// The first layer at a moment: what all Gaussians share of it, and the embeddings' weights.
struct FirstLayer {
  const float *shared, *weights;
};

FirstLayer first_layer(Memory &memory, const FrogDeformation &field) {
  if (!field.temporal) return {field.shared, field.embedding_weight};
  const long long units = static_cast<long long>(field.networks) * field.hidden_width, size = field.embedding_size;
  memory.emplace_back(field.shared, field.shared + units);
  float *shared = memory.back().data();
  for (long long u = 0; u < units; ++u) {
    const float *temporal = field.temporal + u / field.hidden_width * field.temporal_size, *weight = field.temporal_weight + u * field.temporal_size;
    float sums[8] = {};  // one alone would wait for itself
    for (int t = 0; t < field.temporal_size; ++t) sums[t % 8] += weight[t] * temporal[t];
    for (const float sum : sums) shared[u] += sum;
  }
  if (!field.modulation_weight) return {shared, field.embedding_weight};
  memory.emplace_back(field.embedding_weight, field.embedding_weight + units * size);
  float *weights = memory.back().data();
  for (long long u = 0; u < units; ++u) {
    const float *temporal = field.temporal + u / field.hidden_width * field.temporal_size;
    for (long long k = 0; k < size; ++k) weights[u * size + k] += field.modulation_weight[u * size + k] * (temporal[k] - 1);
  }
  return {shared, weights};
}

void plan_groups(Packed &packed, const FirstLayer &first) {
  DeformationPlan &plan = packed.plan;
  const FrogDeformation &field = *plan.field;
  // Means, opacity, colours, and last the scales and the quaternion, which not all groups have.
  const int others = plan.outputs - PLAYED_SHAPE;
  const auto output_of = [=](int r) { return r < 3 ? r : r < others ? r + PLAYED_SHAPE : r - others + 3; };
  plan.shared = pad(packed.memory, first.shared, 1, plan.hidden);
  const auto same = [](int r) { return r; };
  if (!field.kept_products) plan.embedding_rows = turned(packed.memory, first.weights, plan.hidden, plan.embedding, same);
  plan.output_rows = turned(packed.memory, field.output_weight, plan.outputs, plan.hidden, output_of);
  plan.output_bias = turned(packed.memory, field.output_bias, plan.outputs, 1, output_of);
}

// The output layer's parts: one for each head that has a layer of its own, else one for everything. A silenced head's outputs
// are its bias whatever its layer says, so nobody reads that one; a backward pass asks all of them, since outputs that are
// zero at the start learn.
struct Heads {
  int count, read = 0;
  int sizes[5];
  int place[5];  // among those that are read, or -1

  Heads(const FrogDeformation &field, bool backward) : sizes{3, 3, 4, 1, 3 * field.sh_deformed} {
    if (!field.head_width) {
      count = read = 1, sizes[0] = 11 + sizes[4], place[0] = 0;
      return;
    }
    count = field.sh_deformed ? 5 : 4;
    const long long length = static_cast<long long>(field.networks) * field.head_width;
    const float *weight = field.output_weight;
    for (int head = 0; head < count; ++head) {
      const float *end = weight + sizes[head] * length;
      place[head] = backward || std::any_of(weight, end, [](float w) { return w != 0; }) ? read++ : -1;
      weight = end;
    }
  }
};

void plan_first(Packed &packed, const FirstLayer &first, bool backward) {
  DeformationPlan &plan = packed.plan;
  const FrogDeformation &field = *plan.field;
  const int row = static_cast<int>(padded(plan.hidden)), parts = plan.networks;
  plan.shared = pad(packed.memory, first.shared, parts, plan.hidden);
  const Panels forward = panels(packed.memory, plan.embedding, parts * row);
  for (int n = 0; n < parts; ++n) {
    const float *weight = first.weights + static_cast<long long>(n) * plan.hidden * plan.embedding;
    forward.put(weight, plan.embedding, plan.hidden, 1, plan.embedding, 0, n * row);
  }
  plan.embedding_forward = forward.data;
  if (!backward) return;
  const Panels to = panels(packed.memory, parts * row, plan.embedding);
  for (int n = 0; n < parts; ++n) {
    const float *weight = first.weights + static_cast<long long>(n) * plan.hidden * plan.embedding;
    to.put(weight, plan.hidden, plan.embedding, plan.embedding, 1, n * row, 0);
  }
  plan.embedding_backward = to.data;
}

void plan_heads(Packed &packed, const Heads &heads, bool backward) {
  DeformationPlan &plan = packed.plan;
  const FrogDeformation &field = *plan.field;
  const int width = field.head_width;
  packed.memory.emplace_back(static_cast<size_t>(plan.networks * padded(plan.heads)), 0.0f);
  float *bias = packed.memory.back().data();
  plan.head_bias = bias;
  for (int n = 0; n < plan.networks; ++n) {
    const Panels forward = panels(packed.memory, plan.hidden, plan.heads);
    const Panels back = backward ? panels(packed.memory, plan.heads, plan.hidden) : Panels{nullptr, 0};
    plan.head_forward[n] = forward.data, plan.head_backward[n] = back.data;
    for (int head = 0; head < heads.count; ++head) {
      const int first = heads.place[head] * width;
      if (first < 0) continue;
      const long long unit = static_cast<long long>(n * heads.count + head) * width;
      const float *weight = field.head_weight + unit * plan.hidden;
      forward.put(weight, plan.hidden, width, 1, plan.hidden, 0, first);
      if (backward) back.put(weight, width, plan.hidden, plan.hidden, 1, first, 0);
      std::copy_n(field.head_bias + unit, width, bias + n * padded(plan.heads) + first);
    }
  }
}

void plan_outputs(Packed &packed, const Heads &heads, bool backward) {
  DeformationPlan &plan = packed.plan;
  const FrogDeformation &field = *plan.field;
  const int inputs = field.head_width ? field.head_width : plan.hidden;
  // Padded as the outputs' rows are: a branch's padding may reach over the last one.
  packed.memory.emplace_back(static_cast<size_t>(padded(plan.outputs) + DEFORM_PAD), 0.0f);
  plan.output_bias = packed.memory.back().data();
  std::copy_n(field.output_bias, plan.outputs, packed.memory.back().data());
  for (int n = 0; n < plan.networks; ++n) {
    int output = 0;
    for (int head = 0; head < heads.count; ++head) {
      const int place = heads.place[head];
      Branch &branch = plan.branches[plan.branch_count++];
      branch = {n, std::max(0, place) * inputs, place < 0 ? 0 : inputs, output, heads.sizes[head], nullptr, nullptr};
      const long long length = static_cast<long long>(plan.networks) * inputs;
      const float *weight = field.output_weight + output * length + n * inputs;
      branch.forward = pack_transposed(packed.memory, weight, branch.size, inputs, length);
      if (backward) branch.backward = pack(packed.memory, weight, branch.size, inputs, length);
      output += branch.size;
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
  const Heads heads(field, backward);
  plan.heads = field.head_width * heads.read;
  plan.outputs = 11 + 3 * field.sh_deformed;
  packed.memory.reserve(11 + 2 * MAX_BRANCHES);
  const FirstLayer first = first_layer(packed.memory, field);
  if (field.groups) {
    plan_groups(packed, first);
    return packed;
  }
  plan_first(packed, first, backward);
  if (plan.heads) plan_heads(packed, heads, backward);
  plan_outputs(packed, heads, backward);
  return packed;
}

}  // namespace frog
