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

// Images have the size (H, W) of the options' region.
typedef struct {
  float *rgb;             // (H, W, 3)
  float *alpha;           // (H, W)
  int32_t *median_index;  // (H, W) Gaussian that takes transmittance through one half, -1 where none (or null)
  float *mean_depth;      // (H, W) planar depth weighted by blending weight, NaN where nothing was hit (or null)
  float *max_weights;     // (N,) largest blending weight over the pixels (or null)
  float *radii;           // (N,) half the larger side of the splat's bounding box in pixels, 0 if not drawn (or null)
} FrogImage;

typedef struct {
  const float *rgb;    // (H, W, 3) gradient of the loss
  const float *alpha;  // (H, W) (or null: the loss does not look at it)
  int64_t slot_limit;  // (Gaussian, tile) pairs whose gradients may be in memory at a time, 36 bytes each
} FrogImageGradient;

enum { GROUP_SIZE = 16 };  // Gaussians side by side in `groups`

enum { FROG_OPACITY_OFF = 0, FROG_OPACITY_PAPER = 1, FROG_OPACITY_UNIT = 2 };

// The canonical field and the deformation network at one time. Arrays are laid out as torch's parameters are.
typedef struct {
  int32_t count;        // N
  int32_t num_dynamic;  // deformed Gaussians, which come first; the others are static
  int32_t embedding_size, hidden_width;
  int32_t head_width;                        // of each head's hidden layer; 0: all outputs read the first layer
  int32_t networks;                          // 1 or 2 of this shape, whose outputs add up
  int32_t sh_count, sh_active, sh_deformed;  // coefficients there are, that come out, and that the network changes
  int32_t opacity_form;
  int32_t unit_quaternions;         // in the forward pass: they come out normalised, as they always do of `groups`
  int32_t precomputed_first_layer;  // `groups` has products with embedding_weight in place of embeddings
  int32_t temporal_size;
  float opacity_sharpness, opacity_share;  // see model/opacity.py
  float motion_unit;                       // world units that an output of one moves a Gaussian by
  // (N, 3), (N, 3), (N, 4), (N,), (N, sh_count, 3)
  const float *means, *log_scales, *quaternions, *opacity_logits, *sh;
  const float *embeddings;                   // (num_dynamic, embedding_size)
  const float *shared;                       // (networks * hidden_width,) the first layer's temporal part and bias
  const float *embedding_weight;             // (networks * hidden_width, embedding_size)
  const float *head_weight, *head_bias;      // (networks * heads * head_width, hidden_width), as many, or null
  const float *output_weight, *output_bias;  // (outputs, networks * (head_width or hidden_width)), (outputs,)
  // For playback, or null. (ceil(N / GROUP_SIZE), rows, GROUP_SIZE): means, opacity_logits, sh_deformed coefficients,
  // log_scales, quaternions, and embeddings or, with precomputed_first_layer, their products with embedding_weight.
  // Nothing else of a Gaussian is read then. All N are dynamic, heads have no layers of their own, and `changes` is
  // not written.
  const float *groups;
  // With `groups`, weights are transposed, their rows padded to a multiple of GROUP_SIZE, and outputs are in the order
  // of the rows there: embedding_weight (embedding_size, units), output_weight (units, outputs), one row of shared and
  // of output_bias. The library may compute the first layer of a time from its temporal embedding t (networks,
  // temporal_size): shared += temporal_weight^T t, with (temporal_size, units), and, unless null, embedding_weight +=
  // modulation_weight (t - 1), with (embedding_size, units).
  const float *temporal, *temporal_weight, *modulation_weight;
} FrogDeformation;

// Deformed, activated Gaussians, or the gradients by them. Where sh_active is more than sh_count, the forward pass
// leaves the coefficients beyond sh_count as they are in the output.
typedef struct {
  float *means, *quaternions, *scales, *opacities, *sh;  // sh is (N, sh_active, 3)
  // (num_dynamic, outputs) what the network added: means, log_scales, quaternions, opacity logit, sh (or null)
  float *changes;
} FrogDeformed;

typedef struct {  // shapes as in FrogDeformation
  float *means, *log_scales, *quaternions, *opacity_logits, *sh, *embeddings, *shared, *embedding_weight;
  float *head_weight, *head_bias, *output_weight, *output_bias;
} FrogDeformationGradients;

enum { FROG_CELL = 16 };  // pixels a side; CELL in native/binding.py

// A drawing and the image it should be.
typedef struct {
  int32_t height, width;
  const float *image;    // (H, W, 3)
  const uint8_t *truth;  // (H, W, 3), its rows `truth_row` bytes apart
  int64_t truth_row;
  float weight;
  float *gradient;  // (H, W, 3) `weight` times that of the mean absolute difference by the drawing
  float *cells;     // (rows, columns) mean squared difference in each cell, of which the image's border cuts the last
  float *truth_floats;  // (H, W, 3) the truth in [0, 1] (or null)
} FrogL1Loss;

// Bytes of an image, `channels` (1 or 3) of each pixel side by side.
typedef struct {
  uint8_t *first;
  int64_t row;  // bytes from one row to the next
  int32_t height, width, channels;
} FrogPixels;

typedef struct FrogFrame FrogFrame;

FROG_EXPORT int32_t frog_abi_version(void);
FROG_EXPORT const char *frog_instruction_set(void);
FROG_EXPORT void frog_set_thread_count(int32_t count);  // 0: one for each core

// Images have sides of 1 to 65,536 pixels and 2^30 pixels at most, and regions lie in the camera's image. What draws or
// compares another does nothing: frog_draw returns null, the others 2.

// Draws, and keeps what the backward pass needs where there will be one; null when memory ran out. Free the result with
// frog_free.
FROG_EXPORT FrogFrame *frog_draw(const FrogGaussians *, const FrogCamera *, const FrogOptions *, FrogImage *,
                                 int32_t differentiable);
// Gradients of the image that a differentiable `frame` drew, with the same Gaussians. Returns 0, or 1 when memory ran
// out.
FROG_EXPORT int32_t frog_backward(FrogFrame *, const FrogGaussians *, const FrogImageGradient *, const FrogGradients *);
// (Gaussian, tile) pairs of a frame.
FROG_EXPORT int64_t frog_count_instances(const FrogFrame *);
// (Gaussian, pixel) pairs that were blended. Returns 0, or 1 when memory ran out.
FROG_EXPORT int32_t frog_count_pairs(FrogFrame *, int64_t *pairs);
FROG_EXPORT void frog_free(FrogFrame *);

// Planar depth of a mesh: vertices (V, 3) in world units, triangles (T, 3) of indices. Fills `depth` (region height,
// width) with that of the nearest triangle along each pixel's central ray, infinity where there is none; what names a
// missing or non-finite vertex is left out, what is nearer than the near plane is cut off. Returns 0, or 1 when memory
// ran out.
FROG_EXPORT int32_t frog_mesh_depth(const float *vertices, int32_t vertex_count, const int32_t *triangles,
                                    int32_t triangle_count, const FrogCamera *, const int32_t region[4],
                                    float near_plane, float *depth);

// The points (count, 3) by their depth plane[0..2] . point + plane[3], the farthest first, equal depths in their order:
// fills the first `seen` of `order` (count,) with the indices, as floats, of those not nearer than `nearest`. Returns 0,
// or 1 when memory ran out.
FROG_EXPORT int32_t frog_depth_order(const float *points, int32_t count, const float plane[4], float nearest,
                                     float *order, int32_t *seen);

// Mean structural similarity of two (H, W, 3) images in [0, 1] (window of 11 pixels, sigma 1.5, zero outside), and its
// gradient (H, W, 3) by the first. Returns 0, or 1 when memory ran out.
FROG_EXPORT int32_t frog_ssim(int32_t height, int32_t width, const float *image, const float *truth, float *similarity,
                              float *gradient);

// Both return 0, or 1 when memory ran out. The backward pass needs nothing kept.
FROG_EXPORT int32_t frog_deform(const FrogDeformation *, const FrogDeformed *);
FROG_EXPORT int32_t frog_deform_backward(const FrogDeformation *, const FrogDeformed *gradients,
                                         const FrogDeformationGradients *);

// Fills the gradient, cells and floats of a comparison, and the mean absolute difference. Returns 0, or 1 when memory
// ran out.
FROG_EXPORT int32_t frog_l1_loss(const FrogL1Loss *, float *absolute);

// Images as numbers that compress well, and back, without loss, in tiles of `side` pixels, less at the right and lower
// edge: line by line, the numbers of a tile one after the other. All arithmetic is modulo 256. Both return 0, or 1 when
// memory ran out.
// Of a tile (channels, height, width): of each pixel its planes (a mask's byte, or green, red less green and blue less
// green), each less the number to its left, and that less the same of the pixel above.
FROG_EXPORT int32_t frog_predict(const FrogPixels *, int32_t side, uint8_t *numbers);
FROG_EXPORT int32_t frog_restore(const uint8_t *numbers, int32_t side, const FrogPixels *);

// One step of Adam for each of `count` parameters. Returns 0, or 1 when memory ran out, before anything was changed.
FROG_EXPORT int32_t frog_adam(const FrogAdam *parameters, int32_t count);
}
