// The deformation network as its kernels see it: sizes, weights packed and padded, and a block's scratch memory.
#pragma once
#include "frog_native.h"

constexpr int DEFORM_BLOCK = 96;     // Gaussians that go through the network together
constexpr int DEFORM_CHUNK = 960;    // Gaussians whose weight gradients are added up together
constexpr int PLAYBACK_CHUNK = 192;  // Gaussians whose groups playback puts together
constexpr int PLAYBACK_MOST = 2;     // groups of Gaussians that playback multiplies at once, at most
constexpr int DEFORM_PAD = 16;  // columns of a panel of the packed matrices: whole vectors of any instruction set
static_assert(PLAYBACK_CHUNK % GROUP_SIZE == 0, "a chunk is whole groups");
static_assert(DEFORM_PAD == GROUP_SIZE, "playback's weights come in rows padded to groups");
constexpr int MAX_BRANCHES = 10;

// Offsets of the outputs: means 3, log_scales 3, quaternions 4, opacity logit 1, then spherical harmonics
// (field/network.py).
enum { OUT_MEANS = 0, OUT_SCALES = 3, OUT_QUATERNIONS = 6, OUT_OPACITY = 10, OUT_SH = 11 };

static inline long long padded(long long length) { return (length + DEFORM_PAD - 1) / DEFORM_PAD * DEFORM_PAD; }

// One linear output layer: of everything when the hidden layer is shared, else of one head of one network.
struct Branch {
  int network, source;    // whose layer it reads, from which column
  int inputs;             // how many columns
  int output, size;       // its numbers among the outputs
  const float *forward;   // (inputs, size) packed
  const float *backward;  // (size, inputs) packed
};

// Two networks without heads are one of twice the width; with heads they share the first matrix product only.
struct DeformationPlan {
  const FrogDeformation *field;
  // hidden and heads, the width of the layers of all heads, are of a network.
  int networks, embedding, hidden, heads, outputs;
  const float *shared;              // (networks, padded(hidden))
  const float *embedding_forward;   // (embedding, networks * padded(hidden)) packed
  const float *embedding_backward;  // (networks * padded(hidden), embedding) packed
  const float *head_bias;           // (networks, padded(heads))
  const float *head_forward[2];     // (hidden, heads) packed
  const float *head_backward[2];    // (heads, hidden) packed
  const float *output_bias;         // (padded(outputs) + DEFORM_PAD,)
  const float *embedding_rows;      // (embedding, padded(hidden)), for playback in groups of embeddings only
  const float *output_rows;         // (hidden, padded(outputs)), for playback in groups only, in whose order they are
  int branch_count;
  Branch branches[MAX_BRANCHES];
};

// Where a block's layers lie in its scratch memory, and a chunk's weight gradients; lengths in floats. A layer of
// `networks` parts has rows of them all.
struct DeformationLayout {
  long long embedding, hidden, heads, outputs;  // row lengths, hidden and heads of one network's part
  long long first_row, second_row, weight_output_row;
  long long input, first, second, result, columns, scales, opacities, reductions, lengths, forward;
  long long by_first, by_second, by_result, by_input, scratch;
  long long weight_embedding, weight_shared, weight_head, bias_head, weight_output, bias_output, partial;
};

static inline DeformationLayout layout_of(const DeformationPlan &plan) {
  DeformationLayout l;
  l.embedding = padded(plan.embedding);
  l.hidden = padded(plan.hidden);
  // A head's padding may reach over the last one's end, and a branch's over the last output.
  l.heads = plan.heads ? padded(plan.heads) + DEFORM_PAD : 0;
  l.outputs = padded(plan.outputs) + (plan.branch_count > 1 ? DEFORM_PAD : 0);
  l.first_row = plan.networks * l.hidden;
  l.second_row = plan.networks * l.heads;
  l.weight_output_row = plan.networks * padded(plan.branches[0].inputs);
  long long at = 0;
  const auto part = [&](long long length) { return (at += length) - length; };
  const auto layer = [&](long long length) { return part(length * DEFORM_BLOCK); };
  l.input = layer(l.embedding);
  l.first = layer(l.first_row);
  l.second = layer(l.second_row);
  l.result = layer(l.outputs);
  l.columns = part(PLAYBACK_MOST * GROUP_SIZE * l.outputs);
  l.scales = part(3 * DEFORM_BLOCK + DEFORM_PAD);  // stored in fours
  l.opacities = layer(1);
  l.reductions = layer(1);
  l.lengths = layer(1);
  l.forward = at;
  l.by_first = layer(l.first_row);
  l.by_second = layer(l.second_row);
  l.by_result = layer(l.outputs);
  l.by_input = layer(l.embedding);
  l.scratch = at;
  at = 0;
  l.weight_embedding = part(l.first_row * l.embedding);
  l.weight_shared = part(l.first_row);
  l.weight_head = part(plan.networks * plan.heads * l.hidden);
  l.bias_head = part(l.second_row);
  l.weight_output = part(plan.outputs * l.weight_output_row);
  l.bias_output = part(l.outputs);
  l.partial = padded(at);
  return l;
}
