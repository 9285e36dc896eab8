// Lists every (tile, Gaussian) pair, Gaussians in the order of their depth: a stable sort by tile alone then gives each
// tile its Gaussians nearest first. Compiled for TILE_KEY = short or int.
#include "common.cuh"
#include "projection.h"

// `order`: Gaussians by depth; `ends`: for each of those, where its pairs end (a running sum of their numbers).
extern "C" __global__ void __launch_bounds__(THREADS)
    emit(int count, const Splat *splats, const int *tile_counts, const long long *order, const long long *ends,
         int width, int columns, TILE_KEY *tiles, int *owners, long long *first_slots) {
  const long long at = static_cast<long long>(blockIdx.x) * THREADS + threadIdx.x;
  const int own = at < count ? static_cast<int>(order[at]) : 0;
  const int pairs = at < count ? tile_counts[own] : 0;
  const long long begin = at < count ? ends[at] - pairs : 0;
  if (at < count) first_slots[own] = begin;

  if (pairs > 0 && pairs <= ALONE) {
    const Splat splat = splats[own];
    long long to = begin;
    for (int row = splat.first_row; row <= splat.last_row; ++row) {
      int first, last;
      tile_span(splat, row, width, first, last);
      for (int column = first; column <= last && to < begin + pairs; ++column, ++to) {
        tiles[to] = static_cast<TILE_KEY>(row * columns + column);
        owners[to] = own;
      }
    }
  }
  // A giant would hold its warp up: all lanes write it, one row of tiles each.
  for (unsigned giants = __ballot_sync(FULL, pairs > ALONE); giants; giants &= giants - 1) {
    const int giver = __ffs(giants) - 1;
    const int giant = __shfl_sync(FULL, own, giver);
    const long long end = __shfl_sync(FULL, begin + pairs, giver);
    long long next = __shfl_sync(FULL, begin, giver);
    const Splat splat = splats[giant];
    for (int start = splat.first_row; start <= splat.last_row; start += WARP) {
      const int row = start + lane_index();
      int first = 0, last = -1;
      if (row <= splat.last_row) tile_span(splat, row, width, first, last);
      int before = last - first + 1;  // becomes the sum over this and all lower lanes
      for (int offset = 1; offset < WARP; offset *= 2) {
        const int lower = __shfl_up_sync(FULL, before, offset);
        if (lane_index() >= offset) before += lower;
      }
      long long to = next + before - (last - first + 1);
      for (int column = first; column <= last && to < end; ++column, ++to) {
        tiles[to] = static_cast<TILE_KEY>(row * columns + column);
        owners[to] = giant;
      }
      next += __shfl_sync(FULL, before, WARP - 1);
    }
  }
}
