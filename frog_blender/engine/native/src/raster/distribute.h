// Sorting into buckets over the pool. Every step counts in blocks and then writes to places known in advance, so that
// threads never meet and the result does not depend on their number.
#pragma once
#include <algorithm>
#include <cstdint>
#include <new>
#include <utility>
#include <vector>

#include "buffer.h"
#include "threads/thread_pool.h"

namespace frog {

struct Keyed {
  uint32_t key, splat;
};

constexpr size_t SORT_BLOCK = 8192;  // pairs that are sorted at a time, each block with a histogram

// Pieces of `count` elements.
struct Blocks {
  size_t count, size;

  int number() const { return static_cast<int>((count + size - 1) / size); }
  template <class Use>
  void each(Use use) const {  // use(block, begin, end)
    parallel_each(number(), [&](int block) { use(block, block * size, std::min(count, (block + 1) * size)); });
  }
};

// Turns counts [block][bucket] into where each block writes each bucket's first element; returns the buckets'
// beginnings.
inline std::vector<size_t> offsets(uint32_t *counts, int blocks, int buckets) {
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
    for (int bucket = 0; bucket < buckets; ++bucket)
      mine[bucket] = std::exchange(next[bucket], next[bucket] + mine[bucket]);
  }
  return begin;
}

// Calls move(k, place) for each element k: places are in the order of digit(k), equal digits in that of the elements.
// Returns the buckets' beginnings.
template <int BUCKETS, class Digit, class Move>
std::vector<size_t> distribute(const Blocks &blocks, Buffer<uint32_t> &histogram, Digit digit, Move move) {
  uint32_t *counts = histogram.resize(static_cast<size_t>(blocks.number()) * BUCKETS);
  blocks.each([&](int block, size_t begin, size_t end) {
    uint32_t *mine = counts + static_cast<size_t>(block) * BUCKETS;
    std::fill_n(mine, BUCKETS, 0);
    for (size_t k = begin; k < end; ++k) ++mine[digit(k)];
  });
  std::vector<size_t> starts = offsets(counts, blocks.number(), BUCKETS);
  blocks.each([&](int block, size_t begin, size_t end) {
    uint32_t *mine = counts + static_cast<size_t>(block) * BUCKETS;
    for (size_t k = begin; k < end; ++k) move(k, mine[digit(k)]++);
  });
  return starts;
}

}  // namespace frog
