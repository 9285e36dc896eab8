// One thread a Gaussian: its splat, and how many tiles that reaches. Compiled for SH_COUNT = 1, 4, 9 or 16.
#include "common.cuh"
#include "projection.h"

extern "C" __global__ void __launch_bounds__(THREADS)
    project(FrogGaussians g, FrogCamera camera, FrogOptions options, const float *pose, Splat *splats, float *depths,
            int *tile_counts, float *radii) {
  const long long at = static_cast<long long>(blockIdx.x) * THREADS + threadIdx.x;
  if (at >= g.count) return;
  const int i = static_cast<int>(at);
  g.sh_count = SH_COUNT;  // a constant: loops unroll, the basis stays in registers
  take_pose(camera, pose);
  Splat splat;
  make_splat(g, camera, options, i, splat);
  int tiles = 0;
  if (splat.radius > 0) {
    for (int row = splat.first_row; row <= splat.last_row; ++row) {
      int first, last;
      tile_span(splat, row, options.region[2], first, last);
      tiles += last - first + 1;
    }
    splats[i] = splat;
  }
  depths[i] = tiles ? splat.depth : 3.0e38f;  // what is not drawn sorts last
  tile_counts[i] = tiles;
  radii[i] = splat.radius;
}
