// From projected splats to a depth-ordered list for every tile.
#pragma once
#include <vector>

#include "internal.h"

struct FrogFrame {
  FrameView view{};
  std::vector<Splat> splats;
  std::vector<uint32_t> tile_splats, tile_slots, slot_begin;
  std::vector<Tile> tiles;  // those with at least one splat first, dearest first
};

namespace frog {
void bin_splats(FrogFrame &frame);
}
