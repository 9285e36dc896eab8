// The deformation field at a time: one thread for each Gaussian. Those beyond the dynamic ones are activated only.
#include "field_layer.cuh"

extern "C" __global__ void __launch_bounds__(THREADS) field(FieldSizes field, FieldArrays from, FieldOutputs to) {
  alignas(16) __shared__ float weights[UNITS][COLUMNS];
  __shared__ float temporal[TEMPORAL], first[UNITS];
  const long long i = static_cast<long long>(blockIdx.x) * THREADS + threadIdx.x;
  const int outputs = OUT_SH + 3 * field.sh_deformed, size = field.embedding_size;
  const bool moves = i < field.num_dynamic;
  float y[OUTPUTS] = {};
  if (blockIdx.x * THREADS < field.num_dynamic) {  // so for the whole block
    float embedding[EMBEDDING];
#pragma unroll
    for (int c = 0; c < EMBEDDING; ++c) embedding[c] = moves && c < size ? from.embeddings[i * size + c] : 0;
#pragma unroll
    for (int o = 0; o < OUTPUTS; ++o) y[o] = moves && o < outputs ? from.output_bias[o] : 0;
    stage_temporal(field, from.temporal_table, temporal);
    for (int begin = 0; begin < field.units; begin += UNITS) {
      stage_layer(field, from, temporal, begin, weights, first);
      for (int u = 0; u < UNITS && moves; ++u) {
        float hidden = first[u];
#pragma unroll
        for (int c = 0; c < EMBEDDING; ++c) hidden += embedding[c] * weights[u][c];
        hidden = hidden < 0 ? 0 : hidden;
#pragma unroll
        for (int o = 0; o < OUTPUTS; ++o) y[o] += hidden * weights[u][EMBEDDING + o];
      }
      __syncthreads();  // before the next tile
    }
  }
  if (i >= field.count) return;
  for (int k = 0; k < 3; ++k) {
    y[OUT_MEANS + k] *= field.motion_unit;
    to.means[3 * i + k] = from.means[3 * i + k] + y[OUT_MEANS + k];
    const float log_scale = from.log_scales[3 * i + k] + y[OUT_SCALES + k];
    to.scales[3 * i + k] = expf(log_scale > 80 ? 80 : log_scale);  // finite: a gradient of zero times it is zero
  }
  for (int k = 0; k < 4; ++k) to.quaternions[4 * i + k] = from.quaternions[4 * i + k] + y[OUT_QUATERNIONS + k];
  const float factor = moves ? reduction_at(field, y[OUT_OPACITY]).factor : 1;
  to.opacities[i] = sigmoid(from.opacity_logits[i] + y[OUT_OPACITY]) * factor;
  const float *sh = from.sh + 3 * i * field.sh_count;
  float *sh_to = to.sh + 3 * i * field.sh_active;
  const int active = 3 * field.sh_active;
#pragma unroll
  for (int k = 0; k < OUTPUTS - OUT_SH; ++k)
    if (k < active) sh_to[k] = sh[k] + y[OUT_SH + k];
  for (int k = OUTPUTS - OUT_SH; k < active; ++k) sh_to[k] = sh[k];
  if (!moves) return;
#pragma unroll
  for (int o = 0; o < OUTPUTS; ++o)
    if (o < outputs) to.changes[i * outputs + o] = y[o];
}
