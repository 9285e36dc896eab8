// The same walk as blend.cu, front to back with the same decisions, and what each pixel sends back to each splat.
// Compiled for ABSOLUTE and LIMIT = 0 or 1.
//
// Each (tile, Gaussian) pair has a slot of its own for its sums, which project_backward.cu adds up in a fixed order:
// no atomics, the same bits in every run, and less traffic than several atomics a pair. Within a tile the sums go
// lanes -> warp by `fold`, warps -> slot through shared memory, a batch of splats at a time.
#include "common.cuh"

constexpr int BATCH = WARP;  // splats staged at once
constexpr int VALUES = ABSOLUTE ? ABSOLUTE_Y + 1 : BY_BLUE + 1;

extern "C" __global__ void __launch_bounds__(THREADS)
    blend_backward(const Splat *splats, const int *tile_splats, const long long *slots, const int *ranges,
                   FrogOptions options, int columns, const float *rgb, const float *alpha, const float *by_rgb,
                   const float *by_alpha, float *gradients) {
  __shared__ Staged staged[BATCH];
  __shared__ long long slot_of[BATCH];
  __shared__ float sums[WARPS][BATCH][VALUES];
  __shared__ unsigned touched[WARPS];  // splats of the batch that a warp has sums for
  const int width = options.region[2];
  const Pixel pixel = pixel_of(columns, width, options.region[3]);
  const long long at = static_cast<long long>(pixel.y) * width + pixel.x;
  const float x = pixel.x + 0.5f, y = pixel.y + 0.5f;
  const int begin = ranges[blockIdx.x], end = ranges[blockIdx.x + 1];
  const int slot = threadIdx.x / QUARTERS, quarter = threadIdx.x % QUARTERS;
  const int owned = folded_index<VALUES>(lane_index());

  // `behind`: the part of the loss that lies behind the current splat, background and alpha included.
  bool open = pixel.inside;
  float transmittance = 1, g_red = 0, g_green = 0, g_blue = 0, behind = 0, limit = 0;
  if (open) {
    g_red = by_rgb[3 * at], g_green = by_rgb[3 * at + 1], g_blue = by_rgb[3 * at + 2];
    behind = g_red * rgb[3 * at] + g_green * rgb[3 * at + 1] + g_blue * rgb[3 * at + 2];
    behind -= by_alpha[at] * (1 - alpha[at]);
    if (LIMIT) limit = options.depth_limit[at];
  }

  float4 coming = make_float4(0, 0, 0, 0);
  if (slot < BATCH) coming = fetch(splats, tile_splats, begin + slot, end, quarter);
  for (int start = begin; start < end; start += BATCH) {
    if (!__syncthreads_or(open)) break;  // the slots of the rest were zeroed when allocated
    if (slot < BATCH) {
      put(staged[slot], quarter, coming);
      if (quarter == 0) slot_of[slot] = start + slot < end ? slots[start + slot] : -1;
    }
    __syncthreads();
    if (slot < BATCH) coming = fetch(splats, tile_splats, start + BATCH + slot, end, quarter);

    unsigned summed = 0;
    if (__any_sync(FULL, open)) {
      const bool near = start + lane_index() < end && reaches(staged[lane_index()], pixel);
      for (unsigned left = __ballot_sync(FULL, near); left; left &= left - 1) {
        const int k = __ffs(left) - 1;
        const Staged &splat = staged[k];
        if (LIMIT && !(splat.depth <= limit)) open = false;
        const Step s = step(splat, x, y, transmittance, open);
        if (!__any_sync(FULL, s.blended)) continue;
        summed |= 1u << k;
        float v[VALUES];
#pragma unroll
        for (int n = 0; n < VALUES; ++n) v[n] = 0;
        if (s.blended) {
          const float by_weight = g_red * splat.red + g_green * splat.green + g_blue * splat.blue;
          behind = fmaf(-s.weight, by_weight, behind);
          v[BY_RED] = s.weight * g_red, v[BY_GREEN] = s.weight * g_green, v[BY_BLUE] = s.weight * g_blue;
          if (!s.clamped) {  // by the logarithm of alpha
            const float by_log = (transmittance * by_weight - behind / (1 - s.alpha)) * s.alpha;
            v[SUM_1] = by_log;
            v[SUM_U] = by_log * s.u, v[SUM_V] = by_log * s.v;
            v[SUM_UU] = v[SUM_U] * s.u, v[SUM_UV] = v[SUM_U] * s.v, v[SUM_VV] = v[SUM_V] * s.v;
            if constexpr (ABSOLUTE) {
              v[ABSOLUTE_X] = fabsf(2 / LOG2E * splat.along * v[SUM_U]);
              v[ABSOLUTE_Y] = fabsf(2 / LOG2E * (splat.lean * v[SUM_U] + splat.across * v[SUM_V]));
            }
          }
          transmittance = s.next;
        }
        fold<VALUES>(v);
        if (owned >= 0) sums[warp_index()][k][owned] = v[0];
      }
    }
    if (lane_index() == 0) touched[warp_index()] = summed;
    __syncthreads();
    for (int n = threadIdx.x; n < BATCH * VALUES; n += THREADS) {
      const int k = n / VALUES, value = n % VALUES;
      float total = 0;
      bool any = false;
#pragma unroll
      for (int warp = 0; warp < WARPS; ++warp)
        if (touched[warp] >> k & 1) {
          total += sums[warp][k][value];
          any = true;
        }
      if (any) gradients[slot_of[k] * VALUES + value] = total;
    }
  }
}
