// From the gradients by bias and embedding weights, those by the temporal weights and, through the fusion, the table: a
// column of the table in each lane, its units and then its rows shared out to the warps.
#include "field.cuh"

extern "C" __global__ void __launch_bounds__(THREADS) field_table(FieldSizes field, FieldArrays from, FieldArrays to) {
  __shared__ float temporal[TEMPORAL], parts[2][WARPS][WARP];
  stage_temporal(field, from.temporal_table, temporal);
  const int t = blockIdx.x * WARP + lane_index(), size = field.embedding_size, length = fused_size(field);
  const bool inside = t < field.temporal_size;
  float by_fused[2] = {};
  for (int half = 0; half < (is_double(field) ? 2 : 1); ++half)
    for (int unit = warp_index(); unit < field.units && inside; unit += WARPS) {
      const int start = fused_start(field, unit), column = half * field.temporal_size + t - start;
      if (column < 0 || column >= length) continue;  // of the other network
      const float by_shared = to.bias[unit];
      to.temporal_weight[unit * length + column] = by_shared * temporal[start + column];
      by_fused[half] += by_shared * from.temporal_weight[unit * length + column];
      if (from.modulation_weight && column < size)
        by_fused[half] += to.embedding_weight[unit * size + column] * from.modulation_weight[unit * size + column];
    }
  for (int half = 0; half < 2; ++half) parts[half][warp_index()][lane_index()] = by_fused[half];
  __syncthreads();
  if (!inside) return;
  float by[2] = {};
  for (int half = 0; half < 2; ++half)
    for (int warp = 0; warp < WARPS; ++warp) by[half] += parts[half][warp][lane_index()];
  float by_coarse = field.fusion == FINE ? 0 : by[0], by_fine = is_double(field) ? by[1] : by[0];
  if (field.fusion == COARSE) by_fine = 0;
  if (field.fusion == PRODUCT) {
    by_coarse *= mixed(field, from.temporal_table, 1, t);
    by_fine *= mixed(field, from.temporal_table, 0, t);
  }
  for (int row = warp_index(); row < field.table_rows; row += WARPS) {
    float sum = 0;
    for (int k = 0; k < 2 * MIXED_ROWS; ++k)
      if (field.rows[k] == row) sum += field.weights[k] * (k < MIXED_ROWS ? by_coarse : by_fine);
    to.temporal_table[row * field.temporal_size + t] = sum;
  }
}
