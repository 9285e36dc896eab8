// One drawn frame: what the backward pass needs, and the memory of the passes.
#pragma once
#include <vector>

#include "buffer.h"
#include "internal.h"
#include "raster/distribute.h"

namespace frog {

// The tiles of one splat in one tile row.
struct RowEntry {
  uint32_t splat;
  uint32_t slot;        // of the first tile
  int16_t first, last;  // tiles, inclusive; last < first when none
};

}  // namespace frog

struct FrogFrame {
  FrameView view{};
  bool in_bands = false;  // not all instances were in memory at once: there is no backward pass
  frog::Buffer<Splat> splats;
  frog::Buffer<Instance> instances;
  frog::Buffer<frog::RowEntry> entries;  // row by row, each in depth order
  std::vector<size_t> row_begin;         // (tiles_y + 1,) into entries
  std::vector<uint32_t> tile_begin;      // (tiles_y, tiles_x + 1) first instance of each tile in its row, and their end
  std::vector<Tile> tiles;               // those listed last, dearest first
  std::vector<uint64_t> row_instances;   // (tiles_y + 1,) first instance of each row
  frog::Buffer<uint32_t> slot_count;     // (N,) tiles of each Gaussian
  frog::Buffer<uint32_t> slot_base;      // (N,) where its slots begin, see Instance
  frog::Buffer<float> transmittance;     // see FrameView
  frog::Buffer<int32_t> reached;
  // Only used while drawing or going backward.
  frog::Buffer<frog::Keyed> order, spare_order;
  frog::Buffer<uint32_t> histogram, slots_moved, slots_seen;
  frog::Buffer<float> slot_weights, slot_gradients, sums, poses;

  size_t bytes() const {
    return splats.bytes() + instances.bytes() + entries.bytes() + slot_count.bytes() + order.bytes() +
           spare_order.bytes() + histogram.bytes() + slot_base.bytes() + slots_moved.bytes() + slots_seen.bytes() +
           slot_weights.bytes() + slot_gradients.bytes() + sums.bytes() + poses.bytes() + transmittance.bytes() +
           reached.bytes();
  }
};

namespace frog {

// Sorts the splats by depth and counts the instances of every tile.
void bin_splats(FrogFrame &frame);

// Lists the instances of the tiles of some rows from `first` on, in place of those listed before: `most` of them, or
// one row's. Returns the row after the last. Call after bin_splats.
int list_tiles(FrogFrame &frame, int first, uint64_t most);

}  // namespace frog
