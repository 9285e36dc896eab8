// What the parts of the CPU rasterizer share: a drawn frame as raw views, and the table of kernels.
#pragma once
#include "deformation/types.h"
#include "frog_native.h"

struct Instance {  // a splat in one tile
  uint32_t splat;  // index of the Gaussian
  uint32_t slot;   // among all instances, ordered by Gaussians and each one's by its tiles
};

struct Tile {  // one tile's job
  int32_t x, y;
  uint32_t begin, end;  // range of instances
};

// Raw views of a frame's arrays, so that kernels compiled for one instruction set never instantiate shared templates.
struct FrameView {
  FrogCamera camera;
  FrogOptions options;
  int32_t count;
  int32_t tiles_x, tiles_y;
  Splat *splats;              // (N,)
  const Instance *instances;  // tile by tile, each in depth order
  // (H, W), where the backward pass begins; null without one. The transmittance behind all that a pixel blended, and
  // how many of its tile's instances it went through.
  float *transmittance;
  int32_t *reached;
  float *slot_weights;  // the largest blending weight of each slot, zero before; or null where nobody asks
};

// Where the backward pass of some tile rows puts its numbers: those of slot s of Gaussian i at
// (s + moved[i]) * SPLAT_GRADIENTS.
struct SlotView {
  float *gradients;
  const uint32_t *moved;  // (N,), null for a whole frame: nothing to look up
};

constexpr int TILE_SCRATCH = 9;

constexpr int SSIM_STRIP = 32;  // rows of a strip

struct Kernels {
  const char *name;
  void (*project)(const FrameView &, const FrogGaussians &, int begin, int end);
  void (*blend)(const FrameView &, const Tile &, const FrogImage &);
  int64_t (*count_blended)(const FrameView &, const Tile &);
  void (*blend_backward)(const FrameView &, const SlotView &, const Tile &, const FrogImageGradient &);
  // `sums` are (N, SPLAT_GRADIENTS); `pose` is (12,) or null, and is added to.
  void (*project_backward)(const FrameView &, const FrogGaussians &, const float *sums, const FrogGradients &,
                           float *pose, int begin, int end);
  // `scratch` has a block's layers; `partial` takes the weight gradients of a chunk, added to what is there.
  void (*deform)(const DeformationPlan &, const FrogDeformed &, int begin, int end, float *scratch);
  void (*playback)(const DeformationPlan &, const FrogDeformed &, int begin, int end, float *scratch);
  void (*deform_backward)(const DeformationPlan &, const FrogDeformed &gradients, const FrogDeformationGradients &,
                          int begin, int end, float *scratch, float *partial);
  // Structural similarity summed over the rows of a strip of one channel; `scratch` has ssim_scratch(width) floats.
  long long (*ssim_scratch)(int width);
  double (*ssim)(int height, int width, const float *image, const float *truth, int channel, int begin, int end,
                 float *gradient, float *scratch);
  void (*adam)(const FrogAdam &, long long begin, long long end);
  // See images/tile_coding.inl.
  void (*predict)(const FrogPixels &, uint8_t *numbers, uint8_t *scratch);
  void (*restore)(const FrogPixels &, const uint8_t *numbers, uint8_t *scratch);
  double (*l1_loss)(const FrogL1Loss &, int row);  // returns the sum of the absolute differences in a row of cells
};

const Kernels *kernels_baseline();
const Kernels *kernels_avx2();
const Kernels *kernels_avx512();
