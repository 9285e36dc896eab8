// Writes every (tile, Gaussian) pair into its tile's list, in an order left to chance, and the Gaussian of each slot.
// A pair's key is its depth above its slot: slots lie in the Gaussians' order, so that sorted keys are nearest first,
// and of equal depths the first Gaussian.
#include "tiles.cuh"

// `tile_lengths` are counted down.
extern "C" __global__ void __launch_bounds__(THREADS)
    emit(int count, const Splat *splats, const int *tile_counts, const int *first_slots, const int *block_slots,
         const int *ranges, const long long *state, int width, int columns, int *tile_lengths,
         unsigned long long *keys, int *owners) {
  const long long at = static_cast<long long>(blockIdx.x) * THREADS + threadIdx.x;
  if (state[1]) return;
  const int i = static_cast<int>(at), slots = block_slots[blockIdx.x];
  const int tiles = at < count ? tile_counts[i] : 0;
  for_each_tile(splats, i, tiles, width, columns, [&](const Splat &splat, int owner, int tile, int number) {
    const int slot = slots + first_slots[owner] + number;
    const int to = ranges[tile] + atomicSub(tile_lengths + tile, 1) - 1;
    const unsigned depth = static_cast<unsigned>(__float_as_int(splat.depth));  // positive: bits order as numbers do
    keys[to] = static_cast<unsigned long long>(depth) << 32 | static_cast<unsigned>(slot);
    owners[slot] = owner;
  });
}
