// Sizes and offsets of the structs that kernels take by value, as a C++ compiler lays them out.
#include "cuda_on_cpu.h"
#include "common.cuh"

// What the kernels copy as four float4 and then read by name.
#define SAME(NAME) static_assert(offsetof(Splat, NAME) == offsetof(Staged, NAME), #NAME)
SAME(x);
SAME(y);
SAME(along);
SAME(lean);
SAME(across);
SAME(log2_opacity);
SAME(red);
SAME(green);
SAME(blue);
SAME(depth);
SAME(extent_x);
SAME(extent_y);
SAME(radius);
SAME(widest);
static_assert(offsetof(Splat, first_row) == offsetof(Staged, rows), "rows");

#define FIELD(STRUCT, NAME) offsetof(STRUCT, NAME)

extern "C" {
extern const size_t gaussians_layout[] = {
    sizeof(FrogGaussians),           FIELD(FrogGaussians, count),       FIELD(FrogGaussians, sh_count),
    FIELD(FrogGaussians, means),     FIELD(FrogGaussians, quaternions), FIELD(FrogGaussians, scales),
    FIELD(FrogGaussians, opacities), FIELD(FrogGaussians, sh)};
extern const size_t camera_layout[] = {sizeof(FrogCamera),       FIELD(FrogCamera, world_to_camera),
                                       FIELD(FrogCamera, fx),    FIELD(FrogCamera, fy),
                                       FIELD(FrogCamera, cx),    FIELD(FrogCamera, cy),
                                       FIELD(FrogCamera, width), FIELD(FrogCamera, height)};
extern const size_t options_layout[] = {sizeof(FrogOptions),
                                        FIELD(FrogOptions, background),
                                        FIELD(FrogOptions, low_pass),
                                        FIELD(FrogOptions, near_plane),
                                        FIELD(FrogOptions, region),
                                        FIELD(FrogOptions, depth_limit)};
extern const size_t gradients_layout[] = {
    sizeof(FrogGradients),        FIELD(FrogGradients, means),     FIELD(FrogGradients, quaternions),
    FIELD(FrogGradients, scales), FIELD(FrogGradients, opacities), FIELD(FrogGradients, sh),
    FIELD(FrogGradients, screen), FIELD(FrogGradients, pose)};
extern const int constants[] = {THREADS, TILE, sizeof(Splat), SPLAT_GRADIENTS};
}
