// The deformation network as its kernels see it: sizes, weights packed and padded, and a block's scratch memory.
#pragma once
#include "frog_native.h"

constexpr int DEFORM_BLOCK = 96;   // Gaussians that go through the network together
constexpr int DEFORM_CHUNK = 960;  // Gaussians whose weight gradients are added up together
constexpr int DEFORM_PAD = 16;     // rows of the packed matrices are padded to whole vectors of any instruction set
constexpr int MAX_BRANCHES = 5;

static inline long long padded(long long length) { return (length + DEFORM_PAD - 1) / DEFORM_PAD * DEFORM_PAD; }

// Exponentials in a Gaussian's activations: its scales, and those of the two sigmoids.
enum { EXP_SCALES = 0, EXP_OPACITY = 3, EXP_REDUCTION = 4, EXPONENTIALS = 5 };

// One linear output layer: of everything when the hidden layer is shared, else of one head.
struct Branch {
  int source;         // column of the layer it reads
  int inputs;         // how many columns
  int output, size;   // its numbers among the outputs
  const float *forward;   // (inputs, padded(size))
  const float *backward;  // (size, padded(inputs))
  const float *bias;      // (padded(size),)
};

struct DeformationPlan {
  const FrogDeformation *field;
  int embedding, hidden, heads, outputs;  // true sizes; heads is the width of all heads' hidden layers, or 0
  const float *shared;                    // (padded(hidden),)
  const float *embedding_forward;         // (embedding, padded(hidden))
  const float *embedding_backward;        // (hidden, padded(embedding))
  const float *head_bias;                 // (padded(heads),)
  const float *head_forward;              // (hidden, padded(heads))
  const float *head_backward;             // (heads, padded(hidden))
  int branch_count;
  Branch branches[MAX_BRANCHES];
};

// Where a block's layers lie in its scratch memory, and a chunk's weight gradients; lengths in floats.
struct DeformationLayout {
  long long embedding, hidden, heads, outputs;  // row lengths
  long long input, first, second, result, by_first, by_second, by_result, by_input, exponentials, scratch;
  long long weight_embedding, weight_shared, weight_head, bias_head, weight_output, bias_output, partial;
};

static inline DeformationLayout layout_of(const DeformationPlan &plan) {
  DeformationLayout l;
  l.embedding = padded(plan.embedding), l.hidden = padded(plan.hidden);
  l.heads = plan.heads ? padded(plan.heads) + DEFORM_PAD : 0;  // a head's padding may reach over the last one's end
  l.outputs = padded(plan.outputs) + DEFORM_PAD;
  long long at = 0;
  auto room = [&](long long length) { const long long here = at; at += length * DEFORM_BLOCK; return here; };
  l.input = room(l.embedding), l.first = room(l.hidden), l.second = room(l.heads), l.result = room(l.outputs);
  l.by_first = room(l.hidden), l.by_second = room(l.heads), l.by_result = room(l.outputs);
  l.by_input = room(l.embedding), l.exponentials = room(EXPONENTIALS);
  l.scratch = at;
  at = 0;
  auto part = [&](long long length) { const long long here = at; at += length; return here; };
  const long long source = plan.heads ? l.heads : l.hidden;
  l.weight_embedding = part(plan.hidden * l.embedding), l.weight_shared = part(l.hidden);
  l.weight_head = part(plan.heads * l.hidden), l.bias_head = part(l.heads);
  l.weight_output = part(plan.outputs * source), l.bias_output = part(l.outputs);
  l.partial = padded(at);
  return l;
}
