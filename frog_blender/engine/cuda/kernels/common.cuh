// What the kernels share: threads of a tile, splats in shared memory, what one of them is at one pixel, and sums over a
// warp. No system header. The constants THREADS and TILE are known to the Python side as well.
#pragma once
#include "types.h"

constexpr int THREADS = TILE * TILE;  // of every block; one tile where pixels are concerned
constexpr int WARP = 32;
constexpr int WARPS = THREADS / WARP;
constexpr unsigned FULL = 0xffffffffu;
constexpr int ALONE = 32;  // a Gaussian of more tiles than this is worked on by its whole warp
constexpr float NOWHERE = 3.0e38f;  // a depth beyond all others

// The pose of a camera, where it lies on the device: a differentiable pose must not cross to the host and back.
static __device__ __forceinline__ void take_pose(FrogCamera &camera, const float *pose) {
  if (pose)
    for (int k = 0; k < 12; ++k) camera.world_to_camera[k] = pose[k];
}

static __device__ __forceinline__ int lane_index() { return threadIdx.x % WARP; }
static __device__ __forceinline__ int warp_index() { return threadIdx.x / WARP; }

// Sum of `value` over the warp's lanes up to this one. For whole warps.
template <class T>
static __device__ __forceinline__ T sum_to_lane(T value) {
  for (int offset = 1; offset < WARP; offset *= 2) {
    const T lower = __shfl_up_sync(FULL, value, offset);
    if (lane_index() >= offset) value += lower;
  }
  return value;
}

// Sum of `value` over the block's threads before this one; `total` becomes that over all. For whole blocks.
template <class T>
static __device__ __forceinline__ T sum_before(T value, T &total) {
  __shared__ T warps[WARPS];
  const T sum = sum_to_lane(value);
  __syncthreads();  // everyone is done with the last call
  if (lane_index() == WARP - 1) warps[warp_index()] = sum;
  __syncthreads();
  T before = 0;
  total = 0;
  for (int warp = 0; warp < WARPS; ++warp) {
    if (warp < warp_index()) before += warps[warp];
    total += warps[warp];
  }
  return before + sum - value;
}

// A warp owns 8 x 4 pixels of its tile, so that a small splat concerns few warps.
struct Pixel {
  int x, y;       // of the region
  int left, top;  // first pixel of the warp
  bool inside;    // of the region
};

static __device__ __forceinline__ Pixel pixel_of(int columns, int width, int height) {
  const int tile_x = blockIdx.x % columns * TILE, tile_y = blockIdx.x / columns * TILE;
  Pixel p;
  p.left = tile_x + warp_index() % 2 * 8;
  p.top = tile_y + warp_index() / 2 * 4;
  p.x = p.left + lane_index() % 8;
  p.y = p.top + lane_index() / 8;
  p.inside = p.x < width && p.y < height;
  return p;
}

// A splat in shared memory; a test holds its fields to those of Splat. They lie 80 bytes apart, not 64: then 32 lanes
// that read 32 splats meet no bank conflict.
struct alignas(16) Staged {
  float x, y, along, lean;
  float across, log2_opacity, red, green;
  float blue, depth, extent_x, extent_y;
  float radius, widest, rows;
  int index;  // of the Gaussian; its place held the rows' padding
  float4 padding;
};
constexpr int QUARTERS = sizeof(Splat) / sizeof(float4);
static_assert(sizeof(Splat) == 64 && sizeof(Staged) == 80, "a splat is four float4");

// Quarter `quarter` of splat number `at` of the tile's list, or nothing beyond its end.
static __device__ __forceinline__ float4 fetch(const Splat *splats, const int *tile_splats, int at, int end,
                                               int quarter) {
  if (at >= end) return make_float4(0, 0, 0, 0);
  const int index = tile_splats[at];
  float4 part = reinterpret_cast<const float4 *>(splats + index)[quarter];
  if (quarter == QUARTERS - 1) part.w = __int_as_float(index);
  return part;
}

static __device__ __forceinline__ void put(Staged &splat, int quarter, const float4 &part) {
  reinterpret_cast<float4 *>(&splat)[quarter] = part;
}

// Can the ellipse reach a pixel centre of the warp's 8 x 4? Never wrongly no: skipping what this denies changes no bit.
static __device__ __forceinline__ bool reaches(const Staged &splat, const Pixel &pixel) {
  const float margin = 0.01f + 1e-5f * (splat.extent_x + splat.extent_y);  // pixels, for rounding
  const float top = pixel.top + 0.5f - splat.y;
  const float low = fmaxf(top, -splat.extent_y), high = fminf(top + 3, splat.extent_y);
  if (low > high + margin) return false;
  // The widest places of the ellipse within these rows, as in tile_span.
  const float reach = splat.log2_opacity - LOG2_ALPHA_MIN;
  const float right_dy = fminf(fmaxf(splat.widest, low), high), left_dy = fminf(fmaxf(-splat.widest, low), high);
  const float right_v = splat.across * right_dy, left_v = splat.across * left_dy;
  const float right_root = sqrtf(fmaxf(reach - right_v * right_v, 0.0f));
  const float left_root = sqrtf(fmaxf(reach - left_v * left_v, 0.0f));
  const float right = (right_root - splat.lean * right_dy) / splat.along + margin;
  const float left = -(left_root + splat.lean * left_dy) / splat.along - margin;
  const float first = pixel.left + 0.5f - splat.x;
  return !(right < first || left > first + 7);  // NaN stays
}

// One splat at one pixel. Explicit fused operations: both directions must take the very same decisions.
struct Touch {
  float u, v;  // whitened offset from the centre, see Splat
  float alpha;
  bool touched, clamped;
};

static __device__ __forceinline__ Touch touch(const Staged &splat, float x, float y) {
  Touch t = {};  // where not touched, alpha is zero
  const float dx = x - splat.x, dy = y - splat.y;
  t.u = fmaf(splat.along, dx, splat.lean * dy);
  t.v = splat.across * dy;
  const float power = fmaf(-t.u, t.u, fmaf(-t.v, t.v, splat.log2_opacity));
  t.touched = power >= LOG2_ALPHA_MIN;
  if (!t.touched) return t;
  const float raw = exp2f(power);
  t.clamped = raw >= ALPHA_MAX;
  t.alpha = t.clamped ? ALPHA_MAX : raw;
  return t;
}

// Sums COUNT numbers over the warp's lanes, each step halving how many numbers a lane still carries: about COUNT + 4
// shuffles instead of 5 COUNT. Afterwards values[0] of a lane is the total of number folded_index(lane).
template <int COUNT, int OFFSET = WARP / 2>
static __device__ __forceinline__ void fold(float *values) {
  if constexpr (OFFSET > 0) {
    constexpr int HALF = (COUNT + 1) / 2;
    const bool upper = lane_index() & OFFSET;
#pragma unroll
    for (int k = 0; k < HALF; ++k) {
      const float low = values[k], high = k + HALF < COUNT ? values[k + HALF < COUNT ? k + HALF : 0] : 0.0f;
      values[k] = (upper ? high : low) + __shfl_xor_sync(FULL, upper ? low : high, OFFSET);
    }
    fold<HALF, OFFSET / 2>(values);
  }
}

// Which number's total `fold` leaves in this lane; -1 for none.
template <int COUNT, int OFFSET = WARP / 2>
static __device__ __forceinline__ int folded_index(int lane) {
  if constexpr (OFFSET == 0) {
    return 0;
  } else {
    constexpr int HALF = (COUNT + 1) / 2;
    const int within = folded_index<HALF, OFFSET / 2>(lane);
    const int index = within + (lane & OFFSET ? HALF : 0);
    return within < 0 || index >= COUNT ? -1 : index;
  }
}
