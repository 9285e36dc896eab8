#include "raster/radix_sort.h"

#include <new>

namespace frog {

std::vector<size_t> offsets(uint32_t *counts, int blocks, int buckets) {
  std::vector<size_t> begin(buckets + 1, 0);
  size_t total = 0;
  for (int bucket = 0; bucket < buckets; ++bucket) {
    begin[bucket] = total;
    for (int block = 0; block < blocks; ++block) {
      uint32_t &entry = counts[static_cast<size_t>(block) * buckets + bucket];
      const uint32_t here = entry;
      entry = static_cast<uint32_t>(total);
      total += here;
    }
  }
  begin[buckets] = total;
  if (total > UINT32_MAX) throw std::bad_alloc();
  return begin;
}

Keyed *radix_sort(Keyed *from, Keyed *spare, size_t count, Buffer<uint32_t> &histogram) {
  constexpr int BITS = 11, BUCKETS = 1 << BITS;
  const Blocks blocks{count, count <= SORT_ONE_THREAD ? SORT_ONE_THREAD : SORT_BLOCK};
  uint32_t *counts = histogram.resize(static_cast<size_t>(blocks.number()) * BUCKETS);
  for (int shift = 0; shift < 32; shift += BITS) {
    blocks.each([&](int block, size_t begin, size_t end) {
      uint32_t *mine = counts + static_cast<size_t>(block) * BUCKETS;
      std::fill_n(mine, BUCKETS, 0);
      for (size_t i = begin; i < end; ++i) ++mine[(from[i].key >> shift) & (BUCKETS - 1)];
    });
    offsets(counts, blocks.number(), BUCKETS);
    blocks.each([&](int block, size_t begin, size_t end) {
      uint32_t *mine = counts + static_cast<size_t>(block) * BUCKETS;
      for (size_t i = begin; i < end; ++i) spare[mine[(from[i].key >> shift) & (BUCKETS - 1)]++] = from[i];
    });
    std::swap(from, spare);
  }
  return from;
}

}  // namespace frog
