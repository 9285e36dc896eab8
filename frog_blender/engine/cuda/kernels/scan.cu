// One block: where each tile's list begins, where each block's slots do, and whether the pairs have room. Where they
// have none every list is empty, `state` says so, and nothing is to be learned from the image.
#include "common.cuh"

// `to`: the sums of the numbers before each; zeros if they come to more than `most`. Returns what they come to.
static __device__ __forceinline__ long long sums_before(const int *from, int *to, int count, int most) {
  const int share = (count + THREADS - 1) / THREADS;
  const int begin = min(count, static_cast<int>(threadIdx.x) * share), end = min(count, begin + share);
  long long own = 0, all;
  for (int k = begin; k < end; ++k) own += from[k];
  long long before = sum_before(own, all);
  for (int k = begin; k < end; ++k) {
    const int value = from[k];
    to[k] = all > most ? 0 : static_cast<int>(before);
    before += value;
  }
  return all;
}

// `state`: the pairs, and 1 if they are more than `most`.
extern "C" __global__ void __launch_bounds__(THREADS)
    scan(int tiles, const int *tile_lengths, int *ranges, int blocks, int *block_slots, int most, long long *state) {
  const long long pairs = sums_before(tile_lengths, ranges, tiles, most);
  sums_before(block_slots, block_slots, blocks, most);
  if (threadIdx.x) return;
  ranges[tiles] = pairs > most ? 0 : static_cast<int>(pairs);
  state[0] = pairs;
  state[1] = pairs > most;
}
