// A tile of the hidden units in shared memory. The kernels are compiled for EMBEDDING and OUTPUTS, to which the numbers
// of an embedding and of the network's outputs are padded.
#pragma once
#include "field.cuh"

constexpr int COLUMNS = EMBEDDING + OUTPUTS;
constexpr int UNITS = COLUMNS > 64 ? 32 : 64;  // what 48 KB hold beside a batch of Gaussians
static_assert(EMBEDDING % 8 == 0 && OUTPUTS % 8 == 0 && UNITS % (4 * WARPS) == 0 && THREADS % UNITS == 0,
              "whole tiles");
static_assert(UNITS * COLUMNS <= 16 * THREADS && UNITS + OUTPUTS <= THREADS, "a thread has 4 x 4 weights at most");

// Of each unit from `begin` on: weights of the embedding at this time, then of the outputs; and what it has at an
// embedding of zero. Zero beyond the last one. By the whole block.
static __device__ __forceinline__ void stage_layer(const FieldSizes &field, const FieldArrays &from,
                                                   const float *temporal, int begin, float (*weights)[COLUMNS],
                                                   float *first) {
  const int outputs = OUT_SH + 3 * field.sh_deformed, size = field.embedding_size, length = fused_size(field);
  for (int n = threadIdx.x; n < UNITS * COLUMNS; n += THREADS) {
    const int unit = begin + n / COLUMNS, column = n % COLUMNS, output = column - EMBEDDING;
    float weight = 0;
    if (unit < field.units && column < size) {
      weight = from.embedding_weight[unit * size + column];
      if (from.modulation_weight)
        weight += from.modulation_weight[unit * size + column] * (temporal[fused_start(field, unit) + column] - 1);
    } else if (unit < field.units && output >= 0 && output < outputs) {
      weight = from.output_weight[output * field.units + unit];
    }
    weights[n / COLUMNS][column] = weight;
  }
  for (int u = warp_index(); u < UNITS; u += WARPS) {
    const int unit = begin + u;
    float sum = 0;
    if (unit < field.units)
      for (int t = lane_index(); t < length; t += WARP)
        sum += from.temporal_weight[unit * length + t] * temporal[fused_start(field, unit) + t];
    for (int offset = WARP / 2; offset; offset /= 2) sum += __shfl_xor_sync(FULL, sum, offset);
    if (lane_index() == 0) first[u] = unit < field.units ? sum + from.bias[unit] : 0;
  }
  __syncthreads();
}

static __device__ __forceinline__ float sigmoid(float x) { return 1 / (1 + expf(-x)); }

static __device__ __forceinline__ bool reduces(const FieldSizes &field) {
  return field.opacity_form != OPACITY_OFF && field.opacity_share != 0;
}

// Factor on the opacity at a change of its logit, and its derivative (model/deformation.py, reduction_factor).
struct Reduction {
  float factor, slope;
};
static __device__ __forceinline__ Reduction reduction_at(const FieldSizes &field, float change) {
  if (!reduces(field)) return {1, 0};
  const float s = sigmoid(field.opacity_sharpness * change), share = field.opacity_share;
  const float slope = share * field.opacity_sharpness * s * (1 - s);
  if (field.opacity_form == OPACITY_PAPER) return {1 - share + share * s, slope};
  return s <= 0.5f ? Reduction{1 - share + share * 2 * s, 2 * slope} : Reduction{1, 0};
}
