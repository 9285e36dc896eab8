#include "raster/radix_sort.h"

#include <new>

namespace frog {

std::vector<size_t> offsets(uint32_t *counts, int blocks, int buckets) {
  // Block by block, as the counts lie in memory.
  std::vector<size_t> begin(buckets + 1, 0);
  for (int block = 0; block < blocks; ++block)
    for (int bucket = 0; bucket < buckets; ++bucket)
      begin[bucket + 1] += counts[static_cast<size_t>(block) * buckets + bucket];
  for (int bucket = 0; bucket < buckets; ++bucket) begin[bucket + 1] += begin[bucket];
  if (begin[buckets] > UINT32_MAX) throw std::bad_alloc();
  std::vector<uint32_t> next(begin.begin(), begin.end() - 1);
  for (int block = 0; block < blocks; ++block) {
    uint32_t *mine = counts + static_cast<size_t>(block) * buckets;
    for (int bucket = 0; bucket < buckets; ++bucket) {
      const uint32_t here = mine[bucket];
      mine[bucket] = next[bucket];
      next[bucket] += here;
    }
  }
  return begin;
}

Keyed *radix_sort(Keyed *from, Keyed *spare, size_t count, Buffer<uint32_t> &histogram) {
  constexpr int BITS = 11, BUCKETS = 1 << BITS;
  const Blocks blocks{count, count <= SORT_ONE_THREAD ? SORT_ONE_THREAD : SORT_BLOCK};
  for (int shift = 0; shift < 32; shift += BITS) {
    distribute<BUCKETS>(
        blocks, histogram, [=](size_t i) { return (from[i].key >> shift) & (BUCKETS - 1); },
        [=](size_t i, uint32_t place) { spare[place] = from[i]; });
    std::swap(from, spare);
  }
  return from;
}

}  // namespace frog
