// What the kernels of the loss share: the block's cell of TILE x TILE pixels, and means weighted by the window of
// structural similarity (11 pixels, sigma 1.5, zero outside the image, as 3DGS has it).
#pragma once
#include "common.cuh"

constexpr int REACH = 5;                // of the window, pixels
constexpr int SIDE = TILE + 2 * REACH;  // of a cell and what its windows reach

struct Place {
  int x, y;
  bool inside;   // the image
  long long at;  // number of the pixel
};

// The pixel `right` and `down` of the first of the block's cell.
static __device__ __forceinline__ Place place_of(int height, int width, int right, int down) {
  const int columns = (width + TILE - 1) / TILE;
  Place place;
  place.x = static_cast<int>(blockIdx.x % columns) * TILE + right;
  place.y = static_cast<int>(blockIdx.x / columns) * TILE + down;
  place.inside = place.x >= 0 && place.y >= 0 && place.x < width && place.y < height;
  place.at = static_cast<long long>(place.y) * width + place.x;
  return place;
}

static __device__ __forceinline__ Place own_place(int height, int width) {
  return place_of(height, width, threadIdx.x % TILE, threadIdx.x / TILE);
}

// An image of bytes (H, W, 3), its rows `row` bytes apart, in [0, 1].
struct Truth {
  const unsigned char *first;
  int row;

  __device__ float at(const Place &place, int channel) const {
    return first[static_cast<long long>(place.y) * row + 3 * place.x + channel] / 255.0f;
  }
};

// The subject's share of that image, and the pixels that do not count; each may be null.
struct Matte {
  const unsigned char *alpha;  // (H, W), its rows `row` bytes apart
  const bool *ignored;         // (H, W)
  const float *drawn;          // (H, W) the drawing's alpha
  float *gradient;             // (H, W) by that
  int row;
  float by_alpha, empty_weight;  // of a difference's sign in it, and of pixels outside the subject in all gradients

  __device__ float alpha_at(const Place &place) const {
    return alpha[static_cast<long long>(place.y) * row + place.x] / 255.0f;
  }
  __device__ bool counts(const Place &place) const { return !ignored || !ignored[place.at]; }
  // Of the drawing: where it does not count, it is black as the truth is.
  __device__ float shown(const float *image, const Place &place, int channel) const {
    return counts(place) ? image[3 * place.at + channel] : 0;
  }
  __device__ float weight(const Place &place) const {
    return !counts(place) ? 0 : alpha && alpha_at(place) == 0 ? empty_weight : 1;
  }
};

template <int MAPS>
struct Windows {
  float around[MAPS][SIDE * SIDE];  // the cell and what its windows reach, row by row
  float rows[MAPS][SIDE * TILE];    // of that the means along each row
};

// Calls fill(n, place) for every place of `around`.
template <class Fill>
static __device__ __forceinline__ void fill_around(int height, int width, const Fill &fill) {
  for (int n = threadIdx.x; n < SIDE * SIDE; n += THREADS)
    fill(n, place_of(height, width, n % SIDE - REACH, n / SIDE - REACH));
}

static __device__ __forceinline__ float window_sum(const float *values, int apart) {
  // exp(-k^2 / (2 * 1.5^2)) for k = -REACH to REACH, divided by their sum.
  const float weights[2 * REACH + 1] = {0.0010283801f, 0.0075987581f, 0.0360007721f, 0.1093606895f,
                                        0.2130055377f, 0.2660117249f, 0.2130055377f, 0.1093606895f,
                                        0.0360007721f, 0.0075987581f, 0.0010283801f};
  float sum = 0;
#pragma unroll
  for (int k = 0; k <= 2 * REACH; ++k) sum += weights[k] * values[k * apart];
  return sum;
}

// Each map's mean around this thread's pixel. For whole blocks; afterwards `around` may be filled again.
template <int MAPS>
static __device__ __forceinline__ void window_means(Windows<MAPS> &maps, float *means) {
  __syncthreads();
  for (int n = threadIdx.x; n < SIDE * TILE; n += THREADS)
    for (int m = 0; m < MAPS; ++m) maps.rows[m][n] = window_sum(maps.around[m] + n / TILE * SIDE + n % TILE, 1);
  __syncthreads();
#pragma unroll
  for (int m = 0; m < MAPS; ++m) means[m] = window_sum(maps.rows[m] + threadIdx.x, TILE);
}
