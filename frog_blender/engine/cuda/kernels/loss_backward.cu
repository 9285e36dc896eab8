// Adds to the gradient `weight` times that of the sum of all similarities, from what loss.cu left in `slopes`.
#include "ssim.cuh"

extern "C" __global__ void __launch_bounds__(THREADS)
    loss_backward(int height, int width, const float *image, const unsigned char *first, int row, Matte matte,
                  const float *slopes, float weight, float *gradient) {
  __shared__ Windows<3> maps;
  const Place own = own_place(height, width);
  const Truth truth = {first, row};
  const long long pixels = static_cast<long long>(height) * width;
  for (int channel = 0; channel < 3; ++channel) {
    fill_around(height, width, [&](int n, const Place &place) {
      for (int m = 0; m < 3; ++m)
        maps.around[m][n] = place.inside ? slopes[(3 * channel + m) * pixels + place.at] : 0;
    });
    float means[3];
    window_means(maps, means);
    if (!own.inside) continue;
    const long long at = 3 * own.at + channel;
    const float slope = means[0] + 2 * matte.shown(image, own, channel) * means[1] + truth.at(own, channel) * means[2];
    gradient[at] += matte.weight(own) * weight * slope;
  }
}
