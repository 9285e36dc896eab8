// A block a hidden unit: takes back what a step did to the unit of the windows, see time_windows.keep_apart.
#include "common.cuh"

// The last `columns` of `size` embeddings are the windows'; `row` of the outputs is the opacity's; weights of layers have
// a row for each of `units`, but `output_weight` a column. `off`: the bias of the windows' unit.
extern "C" __global__ void __launch_bounds__(THREADS)
    windows(int units, int size, int temporal_size, int outputs, int columns, int row, float off,
            float *modulation_weight, float *embedding_weight, float *temporal_weight, float *bias,
            float *output_weight) {
  const int unit = blockIdx.x, first = size - columns;
  float *modulation = modulation_weight + unit * size, *embedding = embedding_weight + unit * size;
  float sum = 0;
  for (int k = first; k < size; ++k) sum += modulation[k];
  const bool own = sum > 0.5f * columns;
  __syncthreads();  // everyone has read what is written now
  for (int k = threadIdx.x; k < size; k += THREADS) {
    if (own || k >= first) modulation[k] = own && k >= first, embedding[k] = 0;
  }
  if (!own) return;
  if (threadIdx.x == 0) bias[unit] = off;
  for (int k = threadIdx.x; k < temporal_size; k += THREADS) temporal_weight[unit * temporal_size + k] = 0;
  for (int k = threadIdx.x; k < outputs; k += THREADS)
    if (k != row) output_weight[k * units + unit] = 0;
}
