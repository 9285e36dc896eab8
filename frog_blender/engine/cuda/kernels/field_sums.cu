// Adds up the blocks' partial sums of field_backward.cu, a number in each lane, and gives the weights' gradients.
#include "field.cuh"

extern "C" __global__ void __launch_bounds__(THREADS)
    field_sums(FieldSizes field, FieldArrays from, FieldArrays to, const float *partials, int partial, int blocks,
               int embedding, int columns) {
  __shared__ float temporal[TEMPORAL], parts[WARPS][WARP];
  stage_temporal(field, from.temporal_table, temporal);
  const int number = blockIdx.x * WARP + lane_index(), size = field.embedding_size;
  float sum = 0;
  if (number < partial)
    for (int block = warp_index(); block < blocks; block += WARPS)
      sum += partials[static_cast<long long>(block) * partial + number];
  parts[warp_index()][lane_index()] = sum;
  __syncthreads();
  if (warp_index() || number >= partial) return;
  for (int warp = 1; warp < WARPS; ++warp) sum += parts[warp][lane_index()];
  const int outputs = OUT_SH + 3 * field.sh_deformed, own = number - (partial - (columns - embedding));
  if (own >= 0) {
    if (own < outputs) to.output_bias[own] = sum;
    return;
  }
  const int unit = number / (columns + 1), column = number % (columns + 1), output = column - embedding;
  if (unit >= field.units) return;
  if (column == columns) {
    to.bias[unit] = sum;
  } else if (column < size) {
    to.embedding_weight[unit * size + column] = sum;
    if (to.modulation_weight)
      to.modulation_weight[unit * size + column] = sum * (temporal[fused_start(field, unit) + column] - 1);
  } else if (output >= 0 && output < outputs) {
    to.output_weight[output * field.units + unit] = sum;
  }
}
