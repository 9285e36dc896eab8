// Planar depth of triangles as a camera sees them: what hides Gaussians behind the objects of a scene.
#pragma once
#include "frog_native.h"

namespace frog {
// Fills `depth` (region height, region width) with the least depth along each pixel's central ray, infinity where no
// triangle is. Triangles that name a vertex beyond `vertex_count`, or one that is not finite, are left out. Throws
// std::bad_alloc.
void draw_mesh_depth(const float *vertices, int vertex_count, const int32_t *triangles, int triangle_count,
                     const FrogCamera &camera, const int32_t region[4], float near_plane, float *depth);
}  // namespace frog
