// The field's backward pass. A block takes chunks of Gaussians in turn: each thread the activations of its own, then
// all of them the network's layers for those of the chunk that have a gradient, a batch at a time (on a part of an
// image few have one). What the weights are sent back is summed in registers and left as the block's partial sums: the
// same order in every run. field_sums.cu adds up the blocks'.
#include "field_layer.cuh"

constexpr int BATCH = WARP;  // a lane for each of its Gaussians
constexpr int EACH = UNITS / WARPS, PART = EMBEDDING / WARPS;
constexpr int QUADS = COLUMNS / 4;
constexpr int PADDED = COLUMNS + 4, PADDED_UNITS = UNITS + 4;  // lanes that read rows in fours meet no bank conflict
static_assert(BATCH * PADDED >= TEMPORAL, "the temporal embedding lies there first");

static __device__ __forceinline__ void add_product(float &sum, const float4 &a, const float4 &b) {
  sum = sum + a.x * b.x + a.y * b.y + a.z * b.z + a.w * b.w;
}
static __device__ __forceinline__ float4 four(const float *from) { return *reinterpret_cast<const float4 *>(from); }

// Whether a Gaussian has a gradient. Those by its coefficients are multiples of the first one's.
static __device__ __forceinline__ bool is_pulled(const FieldSizes &field, const FieldOutputs &by, long long i) {
  bool pulled = by.opacities[i] != 0 || by.quaternions[4 * i + 3] != 0;  // true for NaN too
  for (int k = 0; k < 3; ++k)
    pulled |= by.means[3 * i + k] != 0 || by.scales[3 * i + k] != 0 || by.quaternions[4 * i + k] != 0 ||
              by.sh[3 * i * field.sh_active + k] != 0;
  return pulled;
}

// Fills the gradients of what is not copied: log scales, opacity logits, coefficients; gives the one by the change of
// the opacity logit.
static __device__ __forceinline__ float through_activations(const FieldSizes &field, const FieldArrays &from,
                                                            const FieldOutputs &drawn, const FieldOutputs &by,
                                                            const FieldArrays &to, long long i) {
  for (int k = 0; k < 3; ++k) to.log_scales[3 * i + k] = by.scales[3 * i + k] * drawn.scales[3 * i + k];
  const bool moves = i < field.num_dynamic;
  const float change = moves ? drawn.changes[i * (OUT_SH + 3 * field.sh_deformed) + OUT_OPACITY] : 0;
  const Reduction reduction = moves ? reduction_at(field, change) : Reduction{1, 0};
  const float s = sigmoid(from.opacity_logits[i] + change), by_opacity = by.opacities[i] * s;
  const float by_logit = by_opacity * (1 - s) * reduction.factor;
  to.opacity_logits[i] = by_logit;
  if (to.sh)
#pragma unroll 4
    for (int k = 0; k < 3 * field.sh_count; ++k)
      to.sh[3 * i * field.sh_count + k] = k < 3 * field.sh_active ? by.sh[3 * i * field.sh_active + k] : 0;
  return by_logit + by_opacity * reduction.slope;
}

// A number of a Gaussian's embedding, or the gradient by one of the network's outputs.
static __device__ __forceinline__ float input_of(const FieldSizes &field, const FieldArrays &from,
                                                 const FieldOutputs &by, const FieldArrays &to, long long i, int column,
                                                 float by_change) {
  const int size = field.embedding_size, output = column - EMBEDDING, sh = output - OUT_SH;
  if (output < 0) return column < size ? from.embeddings[i * size + column] : 0;
  if (output < OUT_SCALES) return field.motion_unit * by.means[3 * i + output];
  if (output < OUT_QUATERNIONS) return to.log_scales[3 * i + output - OUT_SCALES];
  if (output < OUT_OPACITY) return by.quaternions[4 * i + output - OUT_QUATERNIONS];
  if (output == OUT_OPACITY) return by_change;
  return sh < 3 * min(field.sh_deformed, field.sh_active) ? by.sh[3 * i * field.sh_active + sh] : 0;
}

extern "C" __global__ void __launch_bounds__(THREADS)
    field_backward(FieldSizes field, FieldArrays from, FieldOutputs drawn, FieldOutputs by, FieldArrays to,
                   float *partials, int partial, int blocks) {
  alignas(16) __shared__ float weights[UNITS][COLUMNS], inputs[BATCH][PADDED];
  alignas(16) __shared__ float hidden[BATCH][PADDED_UNITS], by_hidden[BATCH][PADDED_UNITS];
  __shared__ float first[UNITS], by_changes[THREADS];
  __shared__ int list[THREADS], listed[WARPS];
  const int lane = lane_index(), warp = warp_index(), size = field.embedding_size;
  const int row = threadIdx.x / QUADS * 4, column = threadIdx.x % QUADS * 4;  // of the weights that are this thread's
  float *mine = partials + static_cast<long long>(blockIdx.x) * partial;
  for (int begin = 0; begin < field.units; begin += UNITS) {
    stage_temporal(field, from.temporal_table, inputs[0]);
    stage_layer(field, from, inputs[0], begin, weights, first);
    float sums[4][4] = {}, bias = 0;
    for (long long chunk = blockIdx.x * THREADS; chunk < (begin ? field.num_dynamic : field.count);
         chunk += blocks * THREADS) {
      const long long i = chunk + threadIdx.x;
      bool active = false;
      float by_change = 0;
      if (i < field.count) {
        by_change = through_activations(field, from, drawn, by, to, i);
        active = i < field.num_dynamic && is_pulled(field, by, i);
      }
      if (!begin)
        for (int n = threadIdx.x; n < THREADS * size && chunk * size + n < field.num_dynamic * size; n += THREADS)
          to.embeddings[chunk * size + n] = 0;
      const unsigned votes = __ballot_sync(FULL, active);
      if (lane == 0) listed[warp] = __popc(votes);
      __syncthreads();
      int count = 0, place = __popc(votes & ((1u << lane) - 1));
      for (int w = 0; w < WARPS; count += listed[w++]) place += w < warp ? listed[w] : 0;
      if (active) {
        list[place] = static_cast<int>(i);
        by_changes[place] = by_change;
      }
      __syncthreads();
      for (int at = 0; at < count; at += BATCH) {
        for (int n = threadIdx.x; n < BATCH * COLUMNS; n += THREADS) {
          const int k = at + n / COLUMNS;
          inputs[n / COLUMNS][n % COLUMNS] =
              k < count ? input_of(field, from, by, to, list[k], n % COLUMNS, by_changes[k]) : 0;
        }
        __syncthreads();
        // A lane's Gaussian at the warp's units. Loops are unrolled as far as registers hold.
        float value[EACH], by_value[EACH] = {};
        for (int k = 0; k < EACH; ++k) value[k] = first[warp * EACH + k];
#pragma unroll 1
        for (int c = 0; c < EMBEDDING; c += 4)
          for (int k = 0; k < EACH; ++k)
            add_product(value[k], four(&inputs[lane][c]), four(&weights[warp * EACH + k][c]));
#pragma unroll 1
        for (int c = EMBEDDING; c < COLUMNS; c += 4)
          for (int k = 0; k < EACH; ++k)
            add_product(by_value[k], four(&inputs[lane][c]), four(&weights[warp * EACH + k][c]));
        for (int k = 0; k < EACH; ++k) {
          hidden[lane][warp * EACH + k] = value[k] < 0 ? 0 : value[k];
          by_hidden[lane][warp * EACH + k] = value[k] > 0 ? by_value[k] : 0;
        }
        __syncthreads();
        // Weights, 4 x 4 a thread.
        if (row < UNITS) {
          const float *from_units = column < EMBEDDING ? &by_hidden[0][row] : &hidden[0][row];
#pragma unroll 4
          for (int k = 0; k < BATCH; ++k) {
            const float4 a = four(from_units + k * PADDED_UNITS), b = four(&inputs[k][column]);
            const float left[4] = {a.x, a.y, a.z, a.w}, right[4] = {b.x, b.y, b.z, b.w};
            for (int r = 0; r < 4; ++r)
              for (int c = 0; c < 4; ++c) sums[r][c] += left[r] * right[c];
          }
        }
        if (threadIdx.x < UNITS)
          for (int k = 0; k < BATCH; ++k) bias += by_hidden[k][threadIdx.x];
        else if (threadIdx.x < UNITS + OUTPUTS)
          for (int k = 0; k < BATCH; ++k) bias += inputs[k][EMBEDDING + threadIdx.x - UNITS];
        // A lane's Gaussian: the warp's part of its embedding.
        float by_embedding[PART] = {};
#pragma unroll 1
        for (int u = 0; u < UNITS; u += 4) {
          const float4 g = four(&by_hidden[lane][u]);
          for (int k = 0; k < PART; ++k) {
            const int c = warp * PART + k;
            by_embedding[k] +=
                g.x * weights[u][c] + g.y * weights[u + 1][c] + g.z * weights[u + 2][c] + g.w * weights[u + 3][c];
          }
        }
        for (int k = 0; k < PART && at + lane < count; ++k)
          if (warp * PART + k < size)
            to.embeddings[static_cast<long long>(list[at + lane]) * size + warp * PART + k] += by_embedding[k];
        __syncthreads();  // before the next batch, tile or chunk
      }
    }
    // A unit's sums follow its weights'; the outputs' come last, the same in every tile.
    if (row < UNITS)
      for (int r = 0; r < 4; ++r)
        for (int c = 0; c < 4; ++c) mine[(begin + row + r) * (COLUMNS + 1) + column + c] = sums[r][c];
    if (threadIdx.x < UNITS)
      mine[(begin + threadIdx.x) * (COLUMNS + 1) + COLUMNS] = bias;
    else if (threadIdx.x < UNITS + OUTPUTS)
      mine[partial - OUTPUTS + threadIdx.x - UNITS] = bias;
  }
}
