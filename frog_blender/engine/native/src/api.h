// What the exported functions share, the chosen kernels, sizes and what is returned, and what they call. All of it throws
// std::bad_alloc.
#pragma once
#include <new>

#include "internal.h"

namespace frog {

const Kernels &kernels();  // for this processor

// Sizes of images that the code below can count: tiles in 16 bits, and no side's pixels lost in a float.
constexpr int32_t MOST_SIDE = 65536;
constexpr int64_t MOST_PIXELS = int64_t{1} << 30;

inline bool is_drawable(int32_t width, int32_t height) {
  return width >= 1 && height >= 1 && width <= MOST_SIDE && height <= MOST_SIDE &&
         static_cast<int64_t>(width) * height <= MOST_PIXELS;
}

constexpr int32_t BAD_SIZE = 2;  // what functions return then, besides 0 and 1

// 0, or 1 when memory ran out: exceptions stay on this side of the interface.
template <class Work>
int32_t attempt(Work work) {
  try {
    work();
    return 0;
  } catch (const std::bad_alloc &) {
    return 1;
  }
}

// The deformed Gaussians, and the gradients of what they were deformed from.
void deform(const Kernels &kernels, const FrogDeformation &field, const FrogDeformed &result);
void deform_backward(const Kernels &kernels, const FrogDeformation &field, const FrogDeformed &by,
                     const FrogDeformationGradients &result);

// Fills `result` with the gradients of the image that `frame` drew.
void backward(const Kernels &kernels, FrogFrame &frame, const FrogGaussians &gaussians,
              const FrogImageGradient &gradient, const FrogGradients &result);

// Fills `order` (count,) with the indices of the points (count, 3) whose depth plane[0..2] . point + plane[3] is finite
// and at least `nearest`, the farthest first and equal ones in their order; returns how many. Depths count as equal that
// agree to a part in 2^17, for positive `nearest`. As floats, which textures of every graphics card hold: exact up to
// 2^24.
int32_t depth_order(const float *points, int32_t count, const float plane[4], float nearest, float *order);

// Fills `depth` (region height, region width) with the least depth of triangles along each pixel's central ray, infinity
// where there is none: what hides Gaussians behind the objects of a scene. Triangles that name a vertex beyond
// `vertex_count`, or one that is not finite, are left out.
void draw_mesh_depth(const float *vertices, int vertex_count, const int32_t *triangles, int triangle_count,
                     const FrogCamera &camera, const int32_t region[4], float near_plane, float *depth);

}  // namespace frog
