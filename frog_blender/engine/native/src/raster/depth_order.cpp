#include <algorithm>
#include <cstring>

#include "api.h"
#include "raster/distribute.h"

namespace frog {
namespace {

constexpr int DIGIT = 12, BUCKETS = 1 << DIGIT;  // two digits: a third would cost half as much again
constexpr uint32_t UNSEEN = 0xffffffffu;         // the key of a depth that is no number
constexpr size_t BLOCK = 4 * SORT_BLOCK;

// A number that is the smaller the farther away a depth is.
inline uint32_t key_of(float depth) {
  uint32_t bits;
  std::memcpy(&bits, &depth, 4);
  // Floats of either sign order like these integers; the complement turns the order round.
  return ~(bits & 0x80000000u ? ~bits : bits | 0x80000000u);
}

int32_t depth_order(const float *points, int32_t count, const float plane[4], float nearest, float *order) {
  const Blocks all{static_cast<size_t>(count), BLOCK};
  Buffer<uint32_t> counts, keys, limits;
  uint32_t *key = keys.resize(count), *limit = limits.resize(2 * static_cast<size_t>(all.number()));
  all.each([&](int block, size_t begin, size_t end) {
    uint32_t low = UNSEEN, high = 0;
    for (size_t i = begin; i < end; ++i) {
      const float *p = points + 3 * i;
      const float depth = plane[0] * p[0] + plane[1] * p[1] + plane[2] * p[2] + plane[3];
      const bool seen = depth >= nearest && depth < 1e30f;  // NaN fails both
      key[i] = seen ? key_of(depth) : UNSEEN;
      low = std::min(low, key[i]);
      high = std::max(high, seen ? key[i] : 0);
    }
    limit[2 * block] = low;
    limit[2 * block + 1] = high;
  });
  uint32_t low = UNSEEN, high = 0;
  for (int block = 0; block < all.number(); ++block) {
    low = std::min(low, limit[2 * block]);
    high = std::max(high, limit[2 * block + 1]);
  }
  if (low > high) return 0;  // nothing is seen
  const int shift = std::max(0, 32 - 2 * DIGIT - __builtin_clz((high - low) | 1));  // bits too many for two digits
  const auto shortened = [=](uint32_t of) { return (of - low) >> shift; };

  Buffer<Keyed> halfway;
  Keyed *pairs = halfway.resize(count);
  const size_t seen = distribute<BUCKETS + 1>(  // the last bucket: unseen ones
      all, counts, [=](size_t i) { return key[i] == UNSEEN ? BUCKETS : shortened(key[i]) & (BUCKETS - 1); },
      [=](size_t i, uint32_t place) {
        pairs[place] = {shortened(key[i]) >> DIGIT, static_cast<uint32_t>(i)};
      })[BUCKETS];
  distribute<BUCKETS>(
      {seen, BLOCK}, counts, [=](size_t k) { return pairs[k].key; },
      [=](size_t k, uint32_t place) { order[place] = static_cast<float>(pairs[k].splat); });
  return static_cast<int32_t>(seen);
}

}  // namespace
}  // namespace frog

int32_t frog_depth_order(const float *points, int32_t count, const float plane[4], float nearest, float *order,
                         int32_t *seen) {
  if (count < 0) return frog::BAD_SIZE;
  return frog::attempt([&] { *seen = frog::depth_order(points, count, plane, nearest, order); });
}
