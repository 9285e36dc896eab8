// The C interface of the native library. Plain structs of pointers; no Python, torch or OpenMP.
// Every array is float32, row-major and contiguous. Change frog_abi_version with any change here.
#pragma once
#include <cstdint>

#if defined(_WIN32)
#define FROG_EXPORT __declspec(dllexport)
#else
#define FROG_EXPORT __attribute__((visibility("default")))
#endif

extern "C" {

typedef struct {
  int32_t count;         // N
  int32_t sh_count;      // K = 1, 4, 9 or 16 coefficients a channel
  const float *means;        // (N, 3) world units
  const float *quaternions;  // (N, 4) w x y z, any length but zero
  const float *scales;       // (N, 3) standard deviations, world units
  const float *opacities;    // (N,) in [0, 1]
  const float *sh;           // (N, K, 3)
} FrogGaussians;

typedef struct {
  float world_to_camera[12];  // upper three rows of the 4x4 matrix
  float fx, fy, cx, cy;       // pixels
  int32_t width, height;      // pixels
} FrogCamera;

typedef struct {
  float background[3];
  float low_pass;     // variance in pixels^2 added to each splat's screen covariance
  float near_plane;   // planar depth below which a Gaussian is culled, world units
  int32_t want_depth;    // fill median_index and mean_depth
  int32_t want_weights;  // fill max_weights
} FrogOptions;

typedef struct {
  float *rgb;            // (H, W, 3)
  float *alpha;          // (H, W)
  int32_t *median_index; // (H, W) Gaussian that takes transmittance through one half, -1 where none (or null)
  float *mean_depth;     // (H, W) planar depth weighted by blending weight, NaN where nothing was hit (or null)
  float *max_weights;    // (N,) largest blending weight over the pixels (or null)
  float *radii;          // (N,) half the larger side of the splat's bounding box in pixels, 0 if culled (or null)
} FrogImage;

typedef struct {
  const float *rgb;    // (H, W, 3) gradient of the loss
  const float *alpha;  // (H, W)
} FrogImageGradient;

typedef struct {
  float *means, *quaternions, *scales, *opacities, *sh;  // shapes as in FrogGaussians
  float *screen;                                         // (N, 2) gradient of the pixel position
} FrogGradients;

// One step of a network over a scratch row: row[output..] = act(bias + weights^T row[input..]).
typedef struct {
  int32_t input, inputs, output, outputs;  // offsets and lengths in the scratch row; outputs a multiple of 16
  int32_t relu;
  const float *weights;  // (inputs, outputs)
  const float *bias;     // (outputs,)
} FrogLayer;

typedef struct FrogFrame FrogFrame;

FROG_EXPORT int32_t frog_abi_version(void);
FROG_EXPORT const char *frog_instruction_set(void);
FROG_EXPORT void frog_set_thread_count(int32_t count);  // 0: one for each core
FROG_EXPORT int32_t frog_thread_count(void);

// Draws, and keeps what the backward pass needs; null when memory ran out. Free the result with frog_free.
FROG_EXPORT FrogFrame *frog_draw(const FrogGaussians *, const FrogCamera *, const FrogOptions *, FrogImage *);
// Gradients of the picture that `frame` drew, with the same Gaussians. Returns 0, or 1 when memory ran out.
FROG_EXPORT int32_t frog_backward(const FrogFrame *, const FrogGaussians *, const FrogImage *,
                                  const FrogImageGradient *, const FrogGradients *);
FROG_EXPORT void frog_free(FrogFrame *);

// Hidden layer relu(first[i] + shared), then the layers; the last `outputs` numbers of each row are copied out.
FROG_EXPORT int32_t frog_evaluate_network(int32_t count, int32_t hidden, const float *first, const float *shared,
                                          int32_t layer_count, const FrogLayer *layers, int32_t row_length,
                                          int32_t outputs, float *result);
}
