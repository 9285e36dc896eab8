// The exported functions that code images in tiles. They run on the caller's thread: images are coded several at a
// time.
#include <algorithm>
#include <vector>

#include "api.h"

using frog::BAD_SIZE;
using frog::kernels;

namespace {

constexpr int64_t DETAILS = 12;  // numbers of the four pixels over one of half the size

bool is_coded(const FrogPixels &pixels, int32_t side) {
  return frog::is_drawable(pixels.width, pixels.height) && (pixels.channels == 1 || pixels.channels == 3) && side >= 1;
}

bool is_twice(const FrogPixels &pixels, const FrogPixels &half, int32_t side) {
  return is_coded(half, side) && pixels.channels == 3 && half.channels == 3 && pixels.height == 2 * half.height &&
         pixels.width == 2 * half.width;
}

// The pixels of `whole` over a tile of the image `half` of half its size.
FrogPixels twice(const FrogPixels &tile, const FrogPixels &half, const FrogPixels &whole) {
  const int64_t place = tile.first - half.first, y = place / half.row, x = place % half.row / half.channels;
  return {whole.first + 2 * y * whole.row + 2 * x * whole.channels, whole.row, 2 * tile.height, 2 * tile.width, 3};
}

// Has `code` work on each tile of an image, given the same of `half` (or it once more), its numbers and scratch memory.
template <class Numbers, class Code>
int32_t each_tile(const FrogPixels &pixels, const FrogPixels *half, int32_t side, Numbers *numbers, Code code) {
  if (!is_coded(pixels, side) || (half && !is_twice(pixels, *half, side))) return BAD_SIZE;
  return frog::attempt([&] {
    const FrogPixels &image = half ? *half : pixels;
    std::vector<uint8_t> scratch(static_cast<size_t>(TILE_SCRATCH) * std::min(side, image.width));
    for (int32_t y = 0; y < image.height; y += std::min(side, image.height - y))
      for (int32_t x = 0; x < image.width; x += std::min(side, image.width - x)) {
        const int32_t height = std::min(side, image.height - y), width = std::min(side, image.width - x);
        uint8_t *corner = image.first + y * image.row + int64_t{x} * image.channels;
        const FrogPixels tile = {corner, image.row, height, width, image.channels};
        code(half ? twice(tile, *half, pixels) : tile, tile, numbers, scratch.data());
        numbers += (half ? DETAILS : int64_t{image.channels}) * height * width;
      }
  });
}

}  // namespace

extern "C" {

int32_t frog_predict(const FrogPixels *pixels, const FrogPixels *half, int32_t side, uint8_t *numbers) {
  return each_tile(*pixels, half, side, numbers, half ? kernels().predict_details : kernels().predict);
}

int32_t frog_restore(const uint8_t *numbers, const FrogPixels *half, int32_t side, const FrogPixels *pixels) {
  return each_tile(*pixels, half, side, numbers, half ? kernels().restore_details : kernels().restore);
}
}
