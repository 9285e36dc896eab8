#include "frame.h"

#include <memory>
#include <mutex>

namespace frog {
namespace {

constexpr size_t SPARE_FRAMES = 2;             // training and scrubbing at once
constexpr size_t SPARE_BYTES = 512ull << 20;   // a larger frame's memory goes back to the system
std::mutex spare_mutex;
std::vector<std::unique_ptr<FrogFrame>> *spare = new std::vector<std::unique_ptr<FrogFrame>>;  // outlives unloading

}  // namespace

FrogFrame *take_frame() {
  std::lock_guard<std::mutex> lock(spare_mutex);
  if (spare->empty()) return new FrogFrame;
  FrogFrame *frame = spare->back().release();
  spare->pop_back();
  return frame;
}

void recycle(FrogFrame *frame) {
  if (!frame) return;
  std::unique_ptr<FrogFrame> owned(frame);
  if (owned->bytes() > SPARE_BYTES) return;
  std::lock_guard<std::mutex> lock(spare_mutex);
  if (spare->size() < SPARE_FRAMES) spare->push_back(std::move(owned));
}

}  // namespace frog
