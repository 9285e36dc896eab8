// What the exported functions share: the chosen kernels, sizes and what is returned.
#pragma once
#include <new>

#include "internal.h"

namespace frog {

const Kernels &kernels();  // for this processor

// Sizes of images that the code below can count: tiles in 16 bits, and no side's pixels lost in a float.
constexpr int32_t MOST_SIDE = 65536;
constexpr int64_t MOST_PIXELS = int64_t{1} << 30;

inline bool is_drawable(int32_t width, int32_t height) {
  return width >= 1 && height >= 1 && width <= MOST_SIDE && height <= MOST_SIDE &&
         static_cast<int64_t>(width) * height <= MOST_PIXELS;
}

constexpr int32_t BAD_SIZE = 2;  // what functions return then, besides 0 and 1

// 0, or 1 when memory ran out: exceptions stay on this side of the interface.
template <class Work>
int32_t attempt(Work work) {
  try {
    work();
    return 0;
  } catch (const std::bad_alloc &) {
    return 1;
  }
}

inline bool lies_within(const FrogCamera &camera, const int32_t region[4]) {
  return is_drawable(region[2], region[3]) && camera.width <= MOST_SIDE && camera.height <= MOST_SIDE &&
         region[0] >= 0 && region[1] >= 0 && region[0] <= camera.width - region[2] &&
         region[1] <= camera.height - region[3];
}

}  // namespace frog
