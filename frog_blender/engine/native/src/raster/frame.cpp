#include "raster/frame.h"

#include <mutex>
#include <utility>

namespace frog {
namespace {

constexpr size_t SPARE_BYTES = 512ull << 20;  // a larger frame's memory goes back to the system
std::mutex spare_mutex;
FrogFrame *spare[2];  // training and scrubbing at once; outlive unloading

}  // namespace

// Nobody waits here: a process forked while another thread was inside would wait for ever.
FrogFrame *take_frame() {
  std::unique_lock<std::mutex> lock(spare_mutex, std::try_to_lock);
  for (FrogFrame *&kept : spare)
    if (lock && kept) return std::exchange(kept, nullptr);
  return new FrogFrame;
}

void recycle(FrogFrame *frame) {
  if (frame && frame->bytes() <= SPARE_BYTES) {
    std::unique_lock<std::mutex> lock(spare_mutex, std::try_to_lock);
    for (FrogFrame *&kept : spare)
      if (lock && !kept) {
        kept = frame;
        return;
      }
  }
  delete frame;
}

}  // namespace frog
