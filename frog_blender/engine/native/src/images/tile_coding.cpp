// The exported functions that code images in tiles. They run on the caller's thread: images are coded several at a time.
#include <algorithm>
#include <vector>

#include "api.h"

using frog::attempt;
using frog::BAD_SIZE;
using frog::kernels;

namespace {

constexpr int32_t DETAILS = 12;  // numbers of the four pixels over one of half the size

bool is_coded(const FrogPixels &pixels, int32_t side) {
  return frog::is_drawable(pixels.width, pixels.height) && (pixels.channels == 1 || pixels.channels == 3) && side >= 1;
}

bool is_twice(const FrogPixels &pixels, const FrogPixels &half, int32_t side) {
  return is_coded(pixels, side) && is_coded(half, side) && pixels.channels == 3 && half.channels == 3 &&
         pixels.height == 2 * half.height && pixels.width == 2 * half.width;
}

// Calls use(tile, where its numbers begin, scratch) for each tile of an image, whose pixels have so many numbers each.
template <class Use>
void each_tile(const FrogPixels &image, int32_t side, int32_t numbers, Use use) {
  std::vector<uint8_t> scratch(static_cast<size_t>(TILE_SCRATCH) * std::min(side, image.width));
  int64_t first = 0;
  for (int32_t y = 0; y < image.height; y += std::min(side, image.height - y))
    for (int32_t x = 0; x < image.width; x += std::min(side, image.width - x)) {
      const int32_t height = std::min(side, image.height - y), width = std::min(side, image.width - x);
      use({image.first + y * image.row + int64_t{x} * image.channels, image.row, height, width, image.channels}, first,
          scratch.data());
      first += static_cast<int64_t>(numbers) * height * width;
    }
}

// The pixels of `whole` over a tile of the image `half` of half its size.
FrogPixels twice(const FrogPixels &tile, const FrogPixels &half, const FrogPixels &whole) {
  const int64_t place = tile.first - half.first, y = place / half.row, x = place % half.row / half.channels;
  return {whole.first + 2 * y * whole.row + 2 * x * whole.channels, whole.row, 2 * tile.height, 2 * tile.width, 3};
}

}  // namespace

extern "C" {

int32_t frog_predict(const FrogPixels *pixels, int32_t side, uint8_t *numbers) {
  if (!is_coded(*pixels, side)) return BAD_SIZE;
  return attempt([&] {
    each_tile(*pixels, side, pixels->channels, [&](const FrogPixels &tile, int64_t first, uint8_t *scratch) {
      kernels().predict(tile, numbers + first, scratch);
    });
  });
}

int32_t frog_restore(const uint8_t *numbers, int32_t side, const FrogPixels *pixels) {
  if (!is_coded(*pixels, side)) return BAD_SIZE;
  return attempt([&] {
    each_tile(*pixels, side, pixels->channels, [&](const FrogPixels &tile, int64_t first, uint8_t *scratch) {
      kernels().restore(numbers + first, tile, scratch);
    });
  });
}

int32_t frog_predict_details(const FrogPixels *pixels, const FrogPixels *half, int32_t side, uint8_t *numbers) {
  if (!is_twice(*pixels, *half, side)) return BAD_SIZE;
  return attempt([&] {
    each_tile(*half, side, DETAILS, [&](const FrogPixels &tile, int64_t first, uint8_t *scratch) {
      kernels().predict_details(twice(tile, *half, *pixels), tile, numbers + first, scratch);
    });
  });
}

int32_t frog_restore_details(const uint8_t *numbers, const FrogPixels *half, int32_t side, const FrogPixels *pixels) {
  if (!is_twice(*pixels, *half, side)) return BAD_SIZE;
  return attempt([&] {
    each_tile(*half, side, DETAILS, [&](const FrogPixels &tile, int64_t first, uint8_t *scratch) {
      kernels().restore_details(numbers + first, tile, twice(tile, *half, *pixels), scratch);
    });
  });
}
}
