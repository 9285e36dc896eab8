// One thread a Gaussian: what a step's drawing and gradients say of its use, see DensityStrategy.observe.
#include "common.cuh"

// `weights`, `by_screen` (N, 2) and `ignored` may be null. `half`: of the image's longer side, pixels. Nothing is
// written where `state` (2,) says that the drawing's pairs had no room.
extern "C" __global__ void __launch_bounds__(THREADS)
    observe(int count, const float *opacities, const float *weights, const float *by_screen, const float *radii,
            const bool *ignored, float half, const long long *state, float *peak_opacity, float *peak_weight,
            float *gradient_sum, float *seen) {
  const long long i = static_cast<long long>(blockIdx.x) * THREADS + threadIdx.x;
  if (i >= count || (state && state[1])) return;
  const bool counts = !ignored || !ignored[i];
  peak_opacity[i] = fmaxf(peak_opacity[i], opacities[i]);
  if (weights && counts) peak_weight[i] = fmaxf(peak_weight[i], weights[i]);
  if (!by_screen) return;
  const float across = by_screen[2 * i], down = by_screen[2 * i + 1];
  gradient_sum[i] += half * sqrtf(across * across + down * down);
  if (counts && radii[i] > 0) seen[i] += 1;
}
