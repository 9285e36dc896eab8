// Every tile that a splat reaches, in one order: where tiles are counted, and where they are listed.
#pragma once
#include "common.cuh"
#include "projection.h"

// Calls visit(splat, index, tile, number) for the tiles of the lane's Gaussian `own`, which are `tiles` in number, row by
// row. For whole warps, behind a barrier if the splats were written by the same kernel.
template <class Visit>
static __device__ __forceinline__ void for_each_tile(const Splat *splats, int own, int tiles, int width, int columns,
                                                     const Visit &visit) {
  if (tiles > 0 && tiles <= ALONE) {
    const Splat splat = splats[own];
    int number = 0;
    for (int row = splat.first_row; row <= splat.last_row; ++row) {
      int first, last;
      tile_span(splat, row, width, first, last);
      for (int column = first; column <= last && number < tiles; ++column, ++number)
        visit(splat, own, row * columns + column, number);
    }
  }
  // A giant would hold its warp up: all lanes go through it, one row of tiles each.
  for (unsigned giants = __ballot_sync(FULL, tiles > ALONE); giants; giants &= giants - 1) {
    const int giver = __ffs(giants) - 1;
    const int giant = __shfl_sync(FULL, own, giver), all = __shfl_sync(FULL, tiles, giver);
    const Splat splat = splats[giant];
    int done = 0;
    for (int start = splat.first_row; start <= splat.last_row; start += WARP) {
      const int row = start + lane_index();
      int first = 0, last = -1;
      if (row <= splat.last_row) tile_span(splat, row, width, first, last);
      const int here = last - first + 1;
      const int so_far = sum_to_lane(here);
      int number = done + so_far - here;
      for (int column = first; column <= last && number < all; ++column, ++number)
        visit(splat, giant, row * columns + column, number);
      done += __shfl_sync(FULL, so_far, WARP - 1);
    }
  }
}
