// The C interface of the native library. Plain structs of pointers; no Python, torch or OpenMP.
// Change frog_abi_version with any change here or in shared/types.h.
#pragma once
#include <cstdint>

#include "shared/types.h"

#if defined(_WIN32)
#define FROG_EXPORT __declspec(dllexport)
#else
#define FROG_EXPORT __attribute__((visibility("default")))
#endif

extern "C" {

// Pictures have the size (H, W) of the options' region.
typedef struct {
  float *rgb;            // (H, W, 3)
  float *alpha;          // (H, W)
  int32_t *median_index; // (H, W) Gaussian that takes transmittance through one half, -1 where none (or null)
  float *mean_depth;     // (H, W) planar depth weighted by blending weight, NaN where nothing was hit (or null)
  float *max_weights;    // (N,) largest blending weight over the pixels (or null)
  float *radii;          // (N,) half the larger side of the splat's bounding box in pixels, 0 if not drawn (or null)
  int32_t *at_fault;     // (1,) Gaussians dropped because a number in them is not finite or out of range (or null)
} FrogImage;

typedef struct {
  const float *rgb;    // (H, W, 3) gradient of the loss
  const float *alpha;  // (H, W)
} FrogImageGradient;

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
FROG_EXPORT int32_t frog_backward(FrogFrame *, const FrogGaussians *, const FrogImage *, const FrogImageGradient *,
                                  const FrogGradients *);
// How much there was to draw: {Gaussians drawn, (Gaussian, tile) pairs, (Gaussian, pixel) pairs blended}.
FROG_EXPORT void frog_count_work(const FrogFrame *, int64_t work[3]);
FROG_EXPORT void frog_free(FrogFrame *);

// Hidden layer relu(first[i] + shared), then the layers; the last `outputs` numbers of each row are copied out.
FROG_EXPORT int32_t frog_evaluate_network(int32_t count, int32_t hidden, const float *first, const float *shared,
                                          int32_t layer_count, const FrogLayer *layers, int32_t row_length,
                                          int32_t outputs, float *result);
}
