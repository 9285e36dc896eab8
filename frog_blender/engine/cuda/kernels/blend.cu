// One block a tile, one thread a pixel: blends the tile's splats front to back.
// Compiled for DEPTH and WEIGHTS = 0 or 1: median and mean depth, largest weights.
#include "common.cuh"

constexpr int BATCH = THREADS / QUARTERS;  // splats staged at once: every thread fetches 16 bytes
static_assert(BATCH % WARP == 0, "a ballot tests 32 splats");

extern "C" __global__ void __launch_bounds__(THREADS)
    blend(const Splat *splats, const int *tile_splats, const int *ranges, FrogOptions options, int columns, float *rgb,
          float *alpha, float *final_transmittance, int *reached, int *median_index, float *mean_depth,
          float *max_weights) {
  __shared__ Staged staged[BATCH];
  const int width = options.region[2];
  const Pixel pixel = pixel_of(columns, width, options.region[3]);
  const long long to = static_cast<long long>(pixel.y) * width + pixel.x;
  const float x = pixel.x + 0.5f, y = pixel.y + 0.5f;
  const int begin = ranges[blockIdx.x], end = ranges[blockIdx.x + 1];
  const int slot = threadIdx.x / QUARTERS, quarter = threadIdx.x % QUARTERS;

  const float limit = pixel.inside && options.depth_limit ? options.depth_limit[to] : NOWHERE;
  bool open = pixel.inside;
  float transmittance = 1, red = 0, green = 0, blue = 0, depth = 0, covered = 0;
  int median = -1, last = 0;  // last: splats gone through until the last that was blended

  float4 coming = fetch(splats, tile_splats, begin + slot, end, quarter);
  for (int start = begin; start < end; start += BATCH) {
    if (!__syncthreads_or(open)) break;  // also: everyone is done with the last batch
    put(staged[slot], quarter, coming);
    __syncthreads();
    coming = fetch(splats, tile_splats, start + BATCH + slot, end, quarter);  // arrives while this batch is blended

    for (int group = 0; group < BATCH && start + group < end; group += WARP) {
      if (!__any_sync(FULL, open)) break;
      const bool near = start + group + lane_index() < end && reaches(staged[group + lane_index()], pixel);
      for (unsigned left = __ballot_sync(FULL, near); left; left &= left - 1) {
        const int k = group + __ffs(left) - 1;
        const Staged &splat = staged[k];
        const Touch t = touch(splat, x, y);
        bool blended = open && t.touched && splat.depth <= limit;
        const float weight = transmittance * t.alpha, next = fmaf(-transmittance, t.alpha, transmittance);
        if (blended && next < TRANSMITTANCE_MIN) open = blended = false;
        if (blended) {
          red = fmaf(weight, splat.red, red);
          green = fmaf(weight, splat.green, green);
          blue = fmaf(weight, splat.blue, blue);
          if (DEPTH) {
            depth = fmaf(weight, splat.depth, depth);
            covered += weight;  // 1 - transmittance has few digits where it is faint
            if (transmittance > 0.5f && next <= 0.5f) median = splat.index;
          }
          transmittance = next;
          last = start - begin + k + 1;
        }
        if (WEIGHTS && __any_sync(FULL, blended)) {
          float heaviest = blended ? weight : 0;
          for (int offset = WARP / 2; offset; offset /= 2)
            heaviest = fmaxf(heaviest, __shfl_xor_sync(FULL, heaviest, offset));
          // Weights are positive: their bits order like integers, and a maximum does not depend on the order.
          if (lane_index() == 0)
            atomicMax(reinterpret_cast<int *>(max_weights) + splat.index, __float_as_int(heaviest));
        }
      }
    }
  }
  if (!pixel.inside) return;
  rgb[3 * to] = fmaf(transmittance, options.background[0], red);
  rgb[3 * to + 1] = fmaf(transmittance, options.background[1], green);
  rgb[3 * to + 2] = fmaf(transmittance, options.background[2], blue);
  alpha[to] = 1 - transmittance;
  if (reached) final_transmittance[to] = transmittance, reached[to] = last;
  if (DEPTH) {
    median_index[to] = median;
    mean_depth[to] = transmittance < 1 ? depth / covered : __int_as_float(0x7fc00000);
  }
}
