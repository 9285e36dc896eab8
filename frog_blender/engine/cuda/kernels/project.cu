// One thread a Gaussian: its splat, how many tiles that reaches, how many splats reach each tile, and where among the
// block's slots its own begin. Compiled for SH_COUNT = 1, 4, 9 or 16.
#include "tiles.cuh"

extern "C" __global__ void __launch_bounds__(THREADS)
    project(FrogGaussians g, FrogCamera camera, FrogOptions options, const float *pose, int columns, Splat *splats,
            int *tile_counts, int *first_slots, int *block_slots, int *tile_lengths, float *radii,
            float *max_weights) {
  const long long at = static_cast<long long>(blockIdx.x) * THREADS + threadIdx.x;
  const int i = static_cast<int>(at), width = options.region[2];
  int tiles = 0;
  if (at < g.count) {
    g.sh_count = SH_COUNT;  // a constant: loops unroll, the basis stays in registers
    take_pose(camera, pose);
    Splat splat;
    make_splat(g, camera, options, i, splat);
    if (splat.radius > 0) {
      for (int row = splat.first_row; row <= splat.last_row; ++row) {
        int first, last;
        tile_span(splat, row, width, first, last);
        tiles += last - first + 1;
      }
      splats[i] = splat;
    }
    tile_counts[i] = tiles;
    radii[i] = splat.radius;
    if (max_weights) max_weights[i] = 0;
  }
  int all;
  const int before = sum_before(tiles, all);
  if (at < g.count) first_slots[i] = before;
  if (threadIdx.x == 0) block_slots[blockIdx.x] = all;
  for_each_tile(splats, i, tiles, width, columns,
                [&](const Splat &, int, int tile, int) { atomicAdd(tile_lengths + tile, 1); });
}
