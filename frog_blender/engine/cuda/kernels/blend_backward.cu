// The backward pass: the same splats with the same decisions as in blend.cu, from the last to the first, and what each
// pixel sends back to each of them. The mathematics is that of native/src/raster/blend_backward.inl.
//
// Each (tile, Gaussian) pair has a slot of its own for its sums, which project_backward.cu adds up in a fixed order:
// no atomics, the same bits in every run, and less traffic than several atomics a pair. Within a tile the sums go
// lanes -> warp by `fold`, warps -> slot through shared memory, a batch of splats at a time.
#include "common.cuh"

constexpr int BATCH = WARP;  // splats staged at once
constexpr int VALUES = SPLAT_GRADIENTS;

extern "C" __global__ void __launch_bounds__(THREADS)
    blend_backward(const Splat *splats, const int *tile_splats, const int *slots, const int *ranges,
                   FrogOptions options, int columns, const float *final_transmittance, const int *reached,
                   const float *by_rgb, const float *by_alpha, float *gradients) {
  __shared__ Staged staged[BATCH];
  __shared__ int slot_of[BATCH];
  __shared__ float sums[WARPS][BATCH][VALUES];
  __shared__ unsigned summed_by[WARPS];  // splats of the batch that a warp has sums for
  __shared__ int furthest[WARPS];
  const int width = options.region[2];
  const Pixel pixel = pixel_of(columns, width, options.region[3]);
  const long long at = static_cast<long long>(pixel.y) * width + pixel.x;
  const float x = pixel.x + 0.5f, y = pixel.y + 0.5f;
  const int slot = threadIdx.x / QUARTERS, quarter = threadIdx.x % QUARTERS;
  const int owned = folded_index<VALUES>(lane_index());

  // `rest`: the part of the loss that lies behind the current splat, background and alpha included.
  float transmittance = 1, g_red = 0, g_green = 0, g_blue = 0, rest = 0;
  const float limit = pixel.inside && options.depth_limit ? options.depth_limit[at] : NOWHERE;
  int last = 0;
  if (pixel.inside) {
    g_red = by_rgb[3 * at];
    g_green = by_rgb[3 * at + 1];
    g_blue = by_rgb[3 * at + 2];
    transmittance = final_transmittance[at];
    last = reached[at];
    rest = g_red * options.background[0] + g_green * options.background[1] + g_blue * options.background[2];
    rest = (rest - (by_alpha ? by_alpha[at] : 0)) * transmittance;
  }
  int most = last;  // of the warp's pixels, then of the tile's
  for (int offset = WARP / 2; offset; offset /= 2) most = max(most, __shfl_xor_sync(FULL, most, offset));
  const int warp_most = most;
  if (lane_index() == 0) furthest[warp_index()] = most;
  __syncthreads();
#pragma unroll
  for (int warp = 0; warp < WARPS; ++warp) most = max(most, furthest[warp]);

  const int begin = ranges[blockIdx.x], end = begin + most;  // no pixel reached the pairs beyond
  for (int n = end + threadIdx.x; n < ranges[blockIdx.x + 1]; n += THREADS)
    for (int value = 0; value < VALUES; ++value) gradients[static_cast<long long>(slots[n]) * VALUES + value] = 0;
  int start = begin + (most - 1) / BATCH * BATCH;
  float4 coming = make_float4(0, 0, 0, 0);
  if (slot < BATCH) coming = fetch(splats, tile_splats, start + slot, end, quarter);
  for (; most > 0 && start >= begin; start -= BATCH) {
    __syncthreads();  // everyone is done with the last batch
    if (slot < BATCH) {
      put(staged[slot], quarter, coming);
      if (quarter == 0) slot_of[slot] = start + slot < end ? slots[start + slot] : -1;
    }
    __syncthreads();
    if (slot < BATCH && start > begin) coming = fetch(splats, tile_splats, start - BATCH + slot, end, quarter);

    unsigned summed = 0;
    if (start - begin < warp_most) {
      const bool near = start + lane_index() < end && reaches(staged[lane_index()], pixel);
      for (unsigned left = __ballot_sync(FULL, near); left;) {
        const int k = WARP - 1 - __clz(left);
        left &= ~(1u << k);
        const Staged &splat = staged[k];
        const Touch t = touch(splat, x, y);
        const bool blended = t.touched && splat.depth <= limit && start - begin + k < last;
        if (!__any_sync(FULL, blended)) continue;
        summed |= 1u << k;
        float v[VALUES] = {};
        if (blended) {
          const float inverse = __frcp_rn(1 - t.alpha);  // rounded well: the errors of all splats add up
          transmittance *= inverse;
          const float weight = transmittance * t.alpha;
          const float own = weight * (g_red * splat.red + g_green * splat.green + g_blue * splat.blue);
          v[BY_RED] = weight * g_red;
          v[BY_GREEN] = weight * g_green;
          v[BY_BLUE] = weight * g_blue;
          if (!t.clamped) {  // by the logarithm of alpha
            const float by_log = fmaf(-rest, t.alpha * inverse, own);
            v[SUM_1] = by_log;
            v[SUM_U] = by_log * t.u;
            v[SUM_V] = by_log * t.v;
            v[SUM_UU] = v[SUM_U] * t.u;
            v[SUM_UV] = v[SUM_U] * t.v;
            v[SUM_VV] = v[SUM_V] * t.v;
          }
          rest += own;
        }
        fold<VALUES>(v);
        if (owned >= 0) sums[warp_index()][k][owned] = v[0];
      }
    }
    if (lane_index() == 0) summed_by[warp_index()] = summed;
    __syncthreads();
    for (int n = threadIdx.x; n < BATCH * VALUES; n += THREADS) {
      const int k = n / VALUES, value = n % VALUES;
      if (slot_of[k] < 0) continue;
      float total = 0;
#pragma unroll
      for (int warp = 0; warp < WARPS; ++warp)
        if (summed_by[warp] >> k & 1) total += sums[warp][k][value];
      gradients[static_cast<long long>(slot_of[k]) * VALUES + value] = total;
    }
  }
}
