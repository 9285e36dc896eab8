#include "raster/frame.h"

#include <memory>
#include <mutex>

namespace frog {
namespace {

constexpr size_t SPARE_FRAMES = 2;            // training and scrubbing at once
constexpr size_t SPARE_BYTES = 512ull << 20;  // a larger frame's memory goes back to the system
std::mutex spare_mutex;

using Frames = std::vector<std::unique_ptr<FrogFrame>>;

Frames *with_room() {
  auto *frames = new Frames;
  frames->reserve(SPARE_FRAMES);  // whoever frees a frame asks for no memory
  return frames;
}

Frames *spare = with_room();  // outlives unloading

}  // namespace

// Nobody waits here: a process forked while another thread was inside would wait for ever.
FrogFrame *take_frame() {
  std::unique_lock<std::mutex> lock(spare_mutex, std::try_to_lock);
  if (!lock || spare->empty()) return new FrogFrame;
  FrogFrame *frame = spare->back().release();
  spare->pop_back();
  return frame;
}

void recycle(FrogFrame *frame) {
  if (!frame) return;
  std::unique_ptr<FrogFrame> owned(frame);
  if (owned->bytes() > SPARE_BYTES) return;
  std::unique_lock<std::mutex> lock(spare_mutex, std::try_to_lock);
  if (lock && spare->size() < SPARE_FRAMES) spare->push_back(std::move(owned));
}

}  // namespace frog
