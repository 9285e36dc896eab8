#include "raster/depth_order.h"

#include <cmath>
#include <cstring>

#include "raster/radix_sort.h"

namespace frog {

int32_t depth_order(const float *points, int32_t count, const float plane[4], float nearest, float *order) {
  const Blocks all{static_cast<size_t>(count), SORT_BLOCK};
  Buffer<uint32_t> counts, histogram;
  Buffer<float> depths;
  float *depth = depths.resize(count);
  uint32_t *here = counts.resize(all.number());
  all.each([&](int block, size_t begin, size_t end) {
    uint32_t seen = 0;
    for (size_t i = begin; i < end; ++i) {
      const float *p = points + 3 * i;
      depth[i] = plane[0] * p[0] + plane[1] * p[1] + plane[2] * p[2] + plane[3];
      seen += depth[i] >= nearest && depth[i] < 1e30f;  // NaN fails both
    }
    here[block] = seen;
  });
  const size_t seen = offsets(here, all.number(), 1).back();
  Buffer<Keyed> pairs, spare;
  Keyed *from = pairs.resize(seen), *to = spare.resize(seen);
  all.each([&](int block, size_t begin, size_t end) {
    uint32_t at = here[block];
    for (size_t i = begin; i < end; ++i)
      if (depth[i] >= nearest && depth[i] < 1e30f) {
        uint32_t bits;
        std::memcpy(&bits, &depth[i], 4);
        // Floats of either sign order like these integers; the complement turns the order round.
        bits = bits & 0x80000000u ? ~bits : bits | 0x80000000u;
        from[at++] = {~bits, static_cast<uint32_t>(i)};
      }
  });
  const Keyed *sorted = radix_sort(from, to, seen, histogram);
  Blocks{seen, SORT_BLOCK}.each([&](int, size_t begin, size_t end) {
    for (size_t i = begin; i < end; ++i) order[i] = static_cast<float>(sorted[i].splat);
  });
  return static_cast<int32_t>(seen);
}

}  // namespace frog
