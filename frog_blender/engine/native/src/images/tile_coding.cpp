// The exported functions that code images in tiles. They run on the caller's thread: images are coded several at a
// time.
#include <algorithm>
#include <vector>

#include "api.h"

using frog::BAD_SIZE;
using frog::kernels;

namespace {

bool is_coded(const FrogPixels &pixels, int32_t side) {
  return frog::is_drawable(pixels.width, pixels.height) && (pixels.channels == 1 || pixels.channels == 3) && side >= 1;
}

// Has `code` work on each tile of an image, given its numbers and scratch memory.
template <class Numbers, class Code>
int32_t each_tile(const FrogPixels &image, int32_t side, Numbers *numbers, Code code) {
  if (!is_coded(image, side)) return BAD_SIZE;
  return frog::attempt([&] {
    std::vector<uint8_t> scratch(static_cast<size_t>(TILE_SCRATCH) * std::min(side, image.width));
    for (int32_t y = 0; y < image.height; y += std::min(side, image.height - y))
      for (int32_t x = 0; x < image.width; x += std::min(side, image.width - x)) {
        const int32_t height = std::min(side, image.height - y), width = std::min(side, image.width - x);
        uint8_t *corner = image.first + y * image.row + int64_t{x} * image.channels;
        code({corner, image.row, height, width, image.channels}, numbers, scratch.data());
        numbers += int64_t{image.channels} * height * width;
      }
  });
}

}  // namespace

extern "C" {

int32_t frog_predict(const FrogPixels *pixels, int32_t side, uint8_t *numbers) {
  return each_tile(*pixels, side, numbers, kernels().predict);
}

int32_t frog_restore(const uint8_t *numbers, int32_t side, const FrogPixels *pixels) {
  return each_tile(*pixels, side, numbers, kernels().restore);
}
}
