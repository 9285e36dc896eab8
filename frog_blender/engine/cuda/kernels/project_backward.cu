// One thread a Gaussian: adds up the slots of its tiles, and turns that into the gradients of its attributes and, where
// wanted, of the camera's pose (a sum for each block). Compiled for SH_COUNT = 1, 4, 9 or 16 and POSE = 0 or 1.
#include "common.cuh"
#include "projection_backward.h"

constexpr int POSE_VALUES = 12;

// `pose_sums` (blocks, 12) where POSE.
extern "C" __global__ void __launch_bounds__(THREADS)
    project_backward(FrogGaussians g, FrogCamera camera, FrogOptions options, const float *pose, const int *tile_counts,
                     const int *first_slots, const int *block_slots, const long long *state,
                     const float *slot_gradients, FrogGradients out, float *pose_sums) {
  const long long at = static_cast<long long>(blockIdx.x) * THREADS + threadIdx.x;
  const int i = static_cast<int>(at);
  const int slots = at < g.count && !state[1] ? tile_counts[i] : 0;
  const long long begin = slots ? block_slots[blockIdx.x] + first_slots[i] : 0;
  const float *own = slot_gradients + begin * SPLAT_GRADIENTS;
  g.sh_count = SH_COUNT;
  take_pose(camera, pose);

  float sums[SPLAT_GRADIENTS] = {};
  if (slots <= ALONE)
    for (int slot = 0; slot < slots; ++slot)
#pragma unroll
      for (int v = 0; v < SPLAT_GRADIENTS; ++v) sums[v] += own[slot * SPLAT_GRADIENTS + v];
  // A giant's slots are shared out among its warp, in an order that never changes.
  for (unsigned giants = __ballot_sync(FULL, slots > ALONE); giants; giants &= giants - 1) {
    const int giver = __ffs(giants) - 1;
    const long long first = __shfl_sync(FULL, own - slot_gradients, giver);
    const int many = __shfl_sync(FULL, slots, giver);
    float part[SPLAT_GRADIENTS] = {};
    for (int slot = lane_index(); slot < many; slot += WARP)
#pragma unroll
      for (int v = 0; v < SPLAT_GRADIENTS; ++v)
        part[v] += slot_gradients[first + static_cast<long long>(slot) * SPLAT_GRADIENTS + v];
#pragma unroll
    for (int v = 0; v < SPLAT_GRADIENTS; ++v) {
      for (int offset = WARP / 2; offset; offset /= 2) part[v] += __shfl_xor_sync(FULL, part[v], offset);
      if (lane_index() == giver) sums[v] = part[v];
    }
  }

  float by_pose[POSE_VALUES] = {};
  if (slots)
    splat_backward(g, camera, options, i, sums, out, POSE ? by_pose : nullptr);
  else if (at < g.count)
    no_gradient(g, out, i);
  if (!POSE) return;

  __shared__ float warps[WARPS][POSE_VALUES];
  fold<POSE_VALUES>(by_pose);
  const int owned = folded_index<POSE_VALUES>(lane_index());
  if (owned >= 0) warps[warp_index()][owned] = by_pose[0];
  __syncthreads();
  if (threadIdx.x >= POSE_VALUES) return;
  float total = 0;
  for (int warp = 0; warp < WARPS; ++warp) total += warps[warp][threadIdx.x];
  pose_sums[static_cast<long long>(blockIdx.x) * POSE_VALUES + threadIdx.x] = total;
}
