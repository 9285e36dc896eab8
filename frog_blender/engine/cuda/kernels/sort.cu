// One block a tile: sorts its list, then writes the Gaussians and slots that the keys stand for. A bitonic network in
// the form in which every comparison puts the smaller key first: beyond the end all keys count as larger than any.
#include "common.cuh"

#ifndef STAGED_KEYS
#define STAGED_KEYS 4096  // what shared memory holds; longer lists are merged where they lie
#endif

typedef unsigned long long Key;

static __device__ __forceinline__ void put_in_order(Key *keys, int low, int high, int count) {
  if (high >= count) return;
  const Key first = keys[low], second = keys[high];
  if (first <= second) return;
  keys[low] = second;
  keys[high] = first;
}

// One round of comparisons among `length` places, a power of two.
static __device__ __forceinline__ void compare(Key *keys, int merged, int apart, int length, int count) {
  __syncthreads();
  for (int pair = threadIdx.x; pair < length / 2; pair += THREADS) {
    const int begin = pair / apart * 2 * apart, within = pair % apart;
    // Both halves are ascending: first each key meets its mirror image.
    const int high = apart == merged / 2 ? begin + merged - 1 - within : begin + apart + within;
    put_in_order(keys, begin + within, high, count);
  }
}

// The merges of `first` to `last` keys, as far as they lie within STAGED_KEYS, in shared memory: a piece of the list at
// a time.
static __device__ __forceinline__ void finish_merges(Key *keys, Key *staged, int first, int last, int count) {
  for (int begin = 0; begin < count; begin += STAGED_KEYS) {
    const int some = min(STAGED_KEYS, count - begin);
    for (int k = threadIdx.x; k < some; k += THREADS) staged[k] = keys[begin + k];
    for (int merged = first; merged <= last; merged *= 2)
      for (int apart = min(merged, STAGED_KEYS) / 2; apart; apart /= 2)
        compare(staged, merged, apart, min(last, STAGED_KEYS), some);
    __syncthreads();
    for (int k = threadIdx.x; k < some; k += THREADS) keys[begin + k] = staged[k];
    __syncthreads();
  }
}

extern "C" __global__ void __launch_bounds__(THREADS)
    sort(const int *ranges, const int *owners, Key *keys, int *tile_splats, int *slots) {
  __shared__ Key staged[STAGED_KEYS];
  const int begin = ranges[blockIdx.x], count = ranges[blockIdx.x + 1] - begin;
  Key *own = keys + begin;
  int length = 1;
  while (length < count) length *= 2;
  finish_merges(own, staged, 2, min(length, STAGED_KEYS), count);
  for (int merged = 2 * STAGED_KEYS; merged <= length; merged *= 2) {
    for (int apart = merged / 2; apart >= STAGED_KEYS; apart /= 2) compare(own, merged, apart, length, count);
    __syncthreads();
    finish_merges(own, staged, merged, merged, count);
  }
  for (int k = threadIdx.x; k < count; k += THREADS) {
    const int slot = static_cast<int>(own[k]);
    slots[begin + k] = slot;
    tile_splats[begin + k] = owners[slot];
  }
}
