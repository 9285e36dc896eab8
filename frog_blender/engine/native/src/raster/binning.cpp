// From projected splats to a depth-ordered list for every tile. Every step counts in blocks and then writes to places
// known in advance, so that threads never meet and the result does not depend on their number.
#include <algorithm>
#include <cmath>
#include <cstring>
#include <numeric>

#include "raster/frame.h"
#include "raster/distribute.h"
#include "threads/thread_pool.h"

namespace frog {
namespace {

#include "shared/projection.h"

constexpr size_t ROW_BLOCK = 1024;         // splats whose rows are listed at a time
constexpr size_t SORT_ONE_THREAD = 32768;  // so few are sorted sooner than shared
constexpr size_t AHEAD = 12;               // places that are fetched before their turn, where one after the other is anywhere

// The `count` pairs of `from` by key, equal keys in their order: stable, least significant digit first. Returns the
// sorted pairs, which are in `from` or in `spare`, each of that size.
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

// The drawn splats by depth. Positive floats order like their bits; equal depths keep index order. Leaves the result in
// frame.order.
size_t sort_by_depth(FrogFrame &frame) {
  const size_t count = frame.view.count;
  Keyed *order = frame.order.resize(count);
  const auto hidden = [&](size_t i) { return !(frame.splats[i].radius > 0); };
  const size_t drawn = distribute<2>({count, SORT_BLOCK}, frame.histogram, hidden, [&](size_t i, uint32_t place) {
    if (hidden(i)) return;
    std::memcpy(&order[place].key, &frame.splats[i].depth, 4);
    order[place].splat = static_cast<uint32_t>(i);
  })[1];
  const Keyed *sorted = radix_sort(order, frame.spare_order.resize(drawn), drawn, frame.histogram);
  if (sorted != order) std::copy_n(sorted, drawn, order);
  return drawn;
}

// What each splat covers in each of its tile rows, row by row in depth order.
void list_rows(FrogFrame &frame, size_t drawn) {
  const FrameView &view = frame.view;
  const Blocks blocks{drawn, ROW_BLOCK};
  const Keyed *order = frame.order.data();
  const int rows = view.tiles_y, width = view.options.region[2];
  uint32_t *counts = frame.histogram.resize(static_cast<size_t>(blocks.number()) * rows);
  blocks.each([&](int block, size_t begin, size_t end) {
    uint32_t *mine = counts + static_cast<size_t>(block) * rows;
    std::fill_n(mine, rows, 0);
    for (size_t k = begin; k < end; ++k) {
      __builtin_prefetch(&frame.splats[order[std::min(k + AHEAD, end - 1)].splat]);
      const Splat &splat = frame.splats[order[k].splat];
      for (int row = splat.first_row; row <= splat.last_row; ++row) ++mine[row];
    }
  });
  frame.row_begin = offsets(counts, blocks.number(), rows);
  RowEntry *entries = frame.entries.resize(frame.row_begin.back());
  blocks.each([&](int block, size_t begin, size_t end) {
    uint32_t *mine = counts + static_cast<size_t>(block) * rows;
    for (size_t k = begin; k < end; ++k) {
      __builtin_prefetch(&frame.splats[order[std::min(k + AHEAD, end - 1)].splat]);
      const uint32_t index = order[k].splat;
      const Splat &splat = frame.splats[index];
      uint32_t slots = 0;
      for (int row = splat.first_row; row <= splat.last_row; ++row) {
        int first, last;
        tile_span(splat, row, width, first, last);
        entries[mine[row]++] = {index, slots, static_cast<int16_t>(first), static_cast<int16_t>(last)};
        slots += last - first + 1;
      }
      frame.slot_count[index] = slots;
    }
  });
}

}  // namespace

void bin_splats(FrogFrame &frame) {
  const FrameView &view = frame.view;
  std::fill_n(frame.slot_count.resize(view.count), view.count, 0u);
  list_rows(frame, sort_by_depth(frame));

  // Instances of each tile: spans begin and end, their running sum counts.
  const int columns = view.tiles_x, rows = view.tiles_y;
  frame.tile_begin.assign(static_cast<size_t>(rows) * (columns + 1), 0);
  frame.row_instances.assign(rows + 1, 0);
  parallel_each(rows, [&](int row) {
    uint32_t *changes = frame.tile_begin.data() + static_cast<size_t>(row) * (columns + 1);
    for (size_t e = frame.row_begin[row]; e < frame.row_begin[row + 1]; ++e) {
      const RowEntry &entry = frame.entries[e];
      if (entry.last < entry.first) continue;
      ++changes[entry.first];
      --changes[entry.last + 1];
    }
    uint64_t total = 0;
    uint32_t here = 0;
    for (int x = 0; x <= columns; ++x) {
      here += changes[x];
      changes[x] = static_cast<uint32_t>(total);
      total += here;
    }
    frame.row_instances[row + 1] = total;
  });
  std::partial_sum(frame.row_instances.begin(), frame.row_instances.end(), frame.row_instances.begin());
  uint32_t *slot_base = frame.slot_base.resize(view.count);
  std::exclusive_scan(frame.slot_count.data(), frame.slot_count.data() + view.count, slot_base, 0u);
}

int list_tiles(FrogFrame &frame, int first, uint64_t most) {
  FrameView &view = frame.view;
  const int columns = view.tiles_x;
  const uint64_t before = frame.row_instances[first];
  int last = first + 1;
  while (last < view.tiles_y && frame.row_instances[last + 1] - before <= most) ++last;
  const uint64_t total = frame.row_instances[last] - before;
  if (total > UINT32_MAX) throw std::bad_alloc();
  Instance *instances = frame.instances.resize(total);
  const uint32_t *slot_base = frame.slot_base.data();
  frame.tiles.resize(static_cast<size_t>(last - first) * columns);
  parallel_each(last - first, [&](int band_row) {
    const int row = first + band_row;
    uint32_t *next = frame.tile_begin.data() + static_cast<size_t>(row) * (columns + 1);
    const uint32_t base = static_cast<uint32_t>(frame.row_instances[row] - before);
    for (int x = 0; x < columns; ++x)
      frame.tiles[static_cast<size_t>(band_row) * columns + x] = {x, row, base + next[x], base + next[x + 1]};
    for (size_t e = frame.row_begin[row]; e < frame.row_begin[row + 1]; ++e) {
      const RowEntry &entry = frame.entries[e];
      __builtin_prefetch(slot_base + frame.entries[std::min(e + AHEAD, frame.row_begin[row + 1] - 1)].splat);
      uint32_t slot = slot_base[entry.splat] + entry.slot;
      for (int x = entry.first; x <= entry.last; ++x) instances[base + next[x]++] = {entry.splat, slot++};
    }
    std::memmove(next + 1, next, columns * sizeof(uint32_t));  // each tile's next is where the one after it begins
    next[0] = 0;
  });
  // Dearest first, so that no thread is left alone with a crowded tile at the end; but only roughly, since neighbours
  // share cache lines and pages.
  auto dearness = [](const Tile &tile) { return std::ilogb(static_cast<float>(tile.end - tile.begin + 1)); };
  std::stable_sort(frame.tiles.begin(), frame.tiles.end(),
                   [&](const Tile &p, const Tile &q) { return dearness(p) > dearness(q); });
  view.instances = instances;
  return last;
}

}  // namespace frog
