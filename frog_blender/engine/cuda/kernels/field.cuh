// The deformation field as its kernels see it (model/frog.py): what it is given, and what is the same for all Gaussians
// at a time. Networks whose outputs add up are one of as many units, each with the temporal embedding of its network.
#pragma once
#include "common.cuh"

constexpr int TEMPORAL = 1024;  // numbers of the fused temporal embeddings at most, of all networks together
constexpr int MIXED_ROWS = 4;   // of the table, at most, that make an embedding: two of its resampling, of two each

enum { PRODUCT, ADD, CONCAT, ATTENTION, COARSE, FINE, DUAL };                            // as field/names.py has them
enum { OPACITY_OFF, OPACITY_PAPER, OPACITY_UNIT };                                       // as structs.py has them
enum { OUT_MEANS, OUT_SCALES = 3, OUT_QUATERNIONS = 6, OUT_OPACITY = 10, OUT_SH = 11 };  // see field/network.py

struct FieldSizes {
  int count, num_dynamic, embedding_size, units, networks, temporal_size, table_rows, fusion;
  int sh_count, sh_active, sh_deformed, opacity_form;
  float opacity_sharpness, opacity_share, motion_unit;
  int rows[2 * MIXED_ROWS];       // of the table, of the coarse embedding and of the fine one
  float weights[2 * MIXED_ROWS];  // theirs
};

// Parameters, or gradients by them; null where there are none.
struct FieldArrays {
  float *means, *log_scales, *quaternions, *opacity_logits, *sh, *embeddings;
  float *temporal_table, *temporal_weight, *bias, *embedding_weight, *modulation_weight, *output_weight, *output_bias;
};

// Gaussians as they are drawn, or gradients by them.
struct FieldOutputs {
  float *means, *quaternions, *scales, *opacities, *sh, *changes;
};

// Temporal embeddings end to end: one, or the coarse and the fine one for one network (CONCAT) or one each (DUAL).
static __device__ __forceinline__ bool is_double(const FieldSizes &field) {
  return field.fusion == CONCAT || field.fusion == DUAL;
}

// Columns of `temporal_weight`.
static __device__ __forceinline__ int fused_size(const FieldSizes &field) {
  return field.fusion == CONCAT ? 2 * field.temporal_size : field.temporal_size;
}

// Where the embedding of a unit's network begins.
static __device__ __forceinline__ int fused_start(const FieldSizes &field, int unit) {
  return unit / (field.units / field.networks) * field.temporal_size;
}

// Number t of the coarse (0) or the fine embedding (1).
static __device__ __forceinline__ float mixed(const FieldSizes &field, const float *table, int which, int t) {
  float sum = 0;
  for (int k = which * MIXED_ROWS; k < (which + 1) * MIXED_ROWS; ++k)
    sum += field.weights[k] * table[field.rows[k] * field.temporal_size + t];
  return sum;
}

// The fused temporal embeddings, by the whole block.
static __device__ __forceinline__ void stage_temporal(const FieldSizes &field, const float *table, float *temporal) {
  for (int t = threadIdx.x; t < field.temporal_size; t += THREADS) {
    const float coarse = mixed(field, table, 0, t), fine = mixed(field, table, 1, t);
    temporal[t] = field.fusion == PRODUCT ? coarse * fine
                  : field.fusion == ADD   ? coarse + fine
                  : field.fusion == FINE  ? fine
                                          : coarse;
    if (is_double(field)) temporal[field.temporal_size + t] = fine;
  }
  __syncthreads();
}
