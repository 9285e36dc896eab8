// What the parts of the CPU rasterizer share: one drawn frame, and the table of kernels.
#pragma once
#include "frog_native.h"

constexpr int TILE = 16;                  // pixels a side
constexpr float ALPHA_MIN = 1.0f / 255;   // fainter contributions are skipped
constexpr float ALPHA_MAX = 0.999f;       // keeps 1 - alpha away from zero
constexpr float TRANSMITTANCE_MIN = 1e-4f;  // a pixel that would fall below is finished
constexpr int INSTANCE_GRADIENTS = 9;     // x y, conic a b c, opacity, r g b

// A Gaussian on the screen. `radius` is 0 for one that is culled.
struct alignas(64) Splat {
  float x, y;                // pixels
  float a, b, c;             // inverse covariance: power = -(a dx^2 + c dy^2) / 2 - b dx dy
  float opacity;
  float red, green, blue;
  float depth;               // planar, world units
  float extent_x, extent_y;  // half sides of the box outside which alpha < ALPHA_MIN
  float lean;                // dy at which the ellipse reaches its largest dx
  float radius;
  int16_t first_row, last_row;  // tile rows, inclusive
  float cutoff;                 // 2 ln(opacity / ALPHA_MIN): the squared distance at which alpha is ALPHA_MIN
};

struct Span {          // tiles of one splat in one tile row
  int16_t first, last;  // inclusive; last < first when empty
  uint32_t slot;        // instance slot of the first tile (slots are grouped by Gaussian)
};

struct Tile {  // one tile's job
  int32_t x, y;
  uint32_t begin, end;  // range in FrameView::tile_splats
};

// Raw views of a frame's arrays, so that kernels compiled for one instruction set never instantiate shared templates.
struct FrameView {
  FrogCamera camera;
  FrogOptions options;
  int32_t count;
  int32_t tiles_x, tiles_y;
  Splat *splats;                 // (N,)
  const uint32_t *tile_splats;   // instances: Gaussian index, tile by tile, in depth order
  const uint32_t *tile_slots;    // instances: where the instance's gradients go
  float *instance_gradients;     // (instances, INSTANCE_GRADIENTS) by slot
  const uint32_t *slot_begin;    // (N + 1,) slots of each Gaussian
};

struct Kernels {
  const char *name;
  void (*project)(const FrameView &, const FrogGaussians &, int begin, int end);
  void (*blend)(const FrameView &, const Tile &, const FrogImage &);
  void (*blend_backward)(const FrameView &, const Tile &, const FrogImage &, const FrogImageGradient &);
  void (*project_backward)(const FrameView &, const FrogGaussians &, const FrogGradients &, int begin, int end);
  void (*network)(int begin, int end, int hidden, const float *first, const float *shared, int layer_count,
                  const FrogLayer *layers, int row_length, int outputs, float *scratch, float *result);
};

const Kernels *kernels_baseline();
const Kernels *kernels_avx2();
const Kernels *kernels_avx512();
