// The backward pass over a whole frame. Each (Gaussian, tile) pair writes to a slot of its own and slots are summed in
// a fixed order, so the result does not depend on the threads. Frames of very many pairs are taken in bands of tile
// rows, so that the slots never need more than the caller allows.
#include <algorithm>

#include "api.h"
#include "raster/frame.h"
#include "threads/thread_pool.h"

namespace frog {
namespace {

constexpr int CHUNK = 1024;  // Gaussians whose pose gradients are added up together

// Gathers the slots of tile rows [first, last): how many each Gaussian has there, and by how much they move in memory.
// Returns how many there are.
size_t place_slots(FrogFrame &frame, int first, int last, uint32_t *count, uint32_t *moved) {
  const int gaussians = frame.view.count;
  std::fill_n(count, gaussians, 0u);
  for (size_t e = frame.row_begin[first]; e < frame.row_begin[last]; ++e)
    count[frame.entries[e].splat] += frame.entries[e].last - frame.entries[e].first + 1;
  uint32_t total = 0;
  for (int i = 0; i < gaussians; ++i) {
    moved[i] = total - frame.slot_base[i] - frame.slots_seen[i];  // wraps; adding a slot of this band wraps back
    total += count[i];
  }
  return total;
}

void backward(FrogFrame &frame, const FrogGaussians &gaussians, const FrogImageGradient &gradient,
              const FrogGradients &result) {
  const FrameView &view = frame.view;
  const int count = view.count;
  float *sums = frame.sums.resize(static_cast<size_t>(count) * SPLAT_GRADIENTS);
  std::fill_n(frame.slots_seen.resize(count), count, 0u);
  const uint64_t limit = static_cast<uint64_t>(gradient.slot_limit);
  for (int first = 0; first < view.tiles_y;) {
    int last = first + 1;
    while (last < view.tiles_y && frame.row_instances[last + 1] - frame.row_instances[first] <= limit) ++last;
    const bool whole = first == 0 && last == view.tiles_y;
    uint32_t *counts = whole ? frame.slot_count.data() : frame.histogram.resize(count);
    uint32_t *moved = whole ? nullptr : frame.slots_moved.resize(count);
    const size_t slots = whole ? frame.row_instances.back() : place_slots(frame, first, last, counts, moved);
    const SlotView slot_view = {frame.slot_gradients.resize(slots * SPLAT_GRADIENTS), moved};
    parallel_each(static_cast<int>(frame.tiles.size()), [&](int t) {
      const Tile &tile = frame.tiles[t];
      if (tile.y >= first && tile.y < last) kernels().blend_backward(view, slot_view, tile, gradient);
    });
    parallel_for(count, CHUNK, [&](int begin, int end) {
      for (int i = begin; i < end; ++i) {
        float total[SPLAT_GRADIENTS] = {};
        float *out = sums + static_cast<size_t>(i) * SPLAT_GRADIENTS;
        if (first > 0) std::copy_n(out, SPLAT_GRADIENTS, total);
        const uint32_t begun = frame.slot_base[i] + frame.slots_seen[i] + (moved ? moved[i] : 0);
        const float *slot = slot_view.gradients + static_cast<size_t>(begun) * SPLAT_GRADIENTS;
        for (uint32_t s = 0; s < counts[i]; ++s, slot += SPLAT_GRADIENTS)
          for (int k = 0; k < SPLAT_GRADIENTS; ++k) total[k] += slot[k];
        std::copy_n(total, SPLAT_GRADIENTS, out);
        frame.slots_seen[i] += counts[i];
      }
    });
    first = last;
  }

  const int chunks = (count + CHUNK - 1) / CHUNK;
  float *poses = result.pose ? frame.poses.resize(static_cast<size_t>(chunks) * 12) : nullptr;
  if (poses) std::fill_n(poses, static_cast<size_t>(chunks) * 12, 0.0f);
  parallel_for(count, CHUNK, [&](int begin, int end) {
    kernels().project_backward(view, gaussians, sums, result, poses ? poses + begin / CHUNK * 12 : nullptr, begin, end);
  });
  if (poses)
    for (int k = 0; k < 12; ++k) {
      double total = 0;
      for (int chunk = 0; chunk < chunks; ++chunk) total += poses[chunk * 12 + k];
      result.pose[k] = static_cast<float>(total);
    }
}

}  // namespace
}  // namespace frog

int32_t frog_backward(FrogFrame *frame, const FrogGaussians *gaussians, const FrogImageGradient *gradient,
                      const FrogGradients *result) {
  return frog::attempt([&] { frog::backward(*frame, *gaussians, *gradient, *result); });
}
