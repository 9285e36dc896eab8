// A drawing against the image it should be, a block a cell: its gradient, and of each cell the sums of squares, of
// absolute differences, of similarities and of alpha's absolute differences, from which the host makes the loss.
// Compiled for SSIM = 0 or 1.
#include "ssim.cuh"

// Similarities of a pixel's colours, added up. `slopes` (3, 3, H, W): by channel, by the means of x, x^2 and xy.
static __device__ __forceinline__ float similarities(const Place &own, int height, int width, const float *image,
                                                     const Truth &truth, const Matte &matte, float *slopes) {
  __shared__ Windows<5> maps;  // x, y, x^2, y^2, xy
  const float c1 = 0.01f * 0.01f, c2 = 0.03f * 0.03f;
  const long long pixels = static_cast<long long>(height) * width;
  float sum = 0;
  for (int channel = 0; channel < 3; ++channel) {
    fill_around(height, width, [&](int n, const Place &place) {
      const float x = place.inside ? matte.shown(image, place, channel) : 0;
      const float y = place.inside ? truth.at(place, channel) : 0;
      const float values[5] = {x, y, x * x, y * y, x * y};
      for (int m = 0; m < 5; ++m) maps.around[m][n] = values[m];
    });
    float means[5];
    window_means(maps, means);
    if (!own.inside) continue;
    const float mx = means[0], my = means[1];
    const float a1 = 2 * mx * my + c1, a2 = 2 * (means[4] - mx * my) + c2;
    const float b1 = mx * mx + my * my + c1, b2 = means[2] - mx * mx + means[3] - my * my + c2;
    const float value = a1 * a2 / (b1 * b2);
    sum += value;
    float *by = slopes + 3 * channel * pixels + own.at;
    by[0] = 2 * my * (a2 - a1) / (b1 * b2) + 2 * mx * value * (1 / b2 - 1 / b1);
    by[pixels] = -value / b2;
    by[2 * pixels] = 2 * a1 / (b1 * b2);
  }
  return sum;
}

// `by_absolute`, `by_square`: what a number's gradient has of the sign of its difference, and of the difference.
// `report`: `state` (2,) as it is, or zeros; then four floats a cell.
extern "C" __global__ void __launch_bounds__(THREADS)
    loss(int height, int width, const float *image, const unsigned char *first, int row, Matte matte, float by_absolute,
         float by_square, const long long *state, float *gradient, float *report, float *slopes) {
  const Place own = own_place(height, width);
  const Truth truth = {first, row};
  float sums[4] = {};
  if (own.inside) {
    const float weight = matte.weight(own);
    for (int channel = 0; channel < 3; ++channel) {
      const long long at = 3 * own.at + channel;
      const float difference = matte.shown(image, own, channel) - truth.at(own, channel);
      sums[0] += difference * difference;
      sums[1] += fabsf(difference);
      gradient[at] = weight * (by_absolute * ((difference > 0) - (difference < 0)) + by_square * difference);
    }
    if (matte.alpha) {
      const float difference = matte.counts(own) ? matte.drawn[own.at] - matte.alpha_at(own) : 0;
      sums[3] = fabsf(difference);
      matte.gradient[own.at] = weight * matte.by_alpha * ((difference > 0) - (difference < 0));
    }
  }
  if (SSIM) sums[2] = similarities(own, height, width, image, truth, matte, slopes);
  long long *states = reinterpret_cast<long long *>(report);
  if (blockIdx.x == 0 && threadIdx.x < 2) states[threadIdx.x] = state ? state[threadIdx.x] : 0;
  float *cell = reinterpret_cast<float *>(states + 2) + 4 * static_cast<long long>(blockIdx.x);
  for (int k = 0; k < 4; ++k) {
    float all;
    sum_before(sums[k], all);
    if (threadIdx.x == 0) cell[k] = all;
  }
}
