#include "images/tile_coding.h"

#include <algorithm>
#include <vector>

namespace frog {
namespace {

struct Planes {
  uint8_t *green, *red, *blue;
};

// A row of red, green and blue as planes, and back.
void split(const uint8_t *pixels, int32_t width, const Planes &planes) {
  for (int32_t x = 0; x < width; ++x) {
    const uint8_t green = pixels[3 * x + 1];
    planes.green[x] = green;
    planes.red[x] = pixels[3 * x] - green;
    planes.blue[x] = pixels[3 * x + 2] - green;
  }
}

void merge(const Planes &planes, int32_t width, uint8_t *pixels) {
  for (int32_t x = 0; x < width; ++x) {
    const uint8_t green = planes.green[x];
    pixels[3 * x] = planes.red[x] + green;
    pixels[3 * x + 1] = green;
    pixels[3 * x + 2] = planes.blue[x] + green;
  }
}

// Rows of `width` bytes of three planes one after the other.
Planes planes_at(uint8_t *first, int64_t plane) { return {first, first + plane, first + 2 * plane}; }

void add(uint8_t *sum, const uint8_t *numbers, int32_t count) {
  for (int32_t i = 0; i < count; ++i) sum[i] += numbers[i];
}

void subtract(const uint8_t *of, const uint8_t *numbers, uint8_t *difference, int32_t count) {
  for (int32_t i = 0; i < count; ++i) difference[i] = of[i] - numbers[i];
}

}  // namespace

void predict(const FrogPixels &pixels, uint8_t *numbers) {
  const int32_t width = pixels.width, channels = pixels.channels;
  const int64_t plane = static_cast<int64_t>(pixels.height) * width;
  std::vector<uint8_t> beside(width * channels), above(width * channels, 0), here(width * channels);
  for (int32_t y = 0; y < pixels.height; ++y) {
    const uint8_t *row = pixels.first + y * pixels.row;
    if (channels == 3)
      split(row, width, planes_at(here.data(), width));
    else
      here.assign(row, row + width);
    for (int32_t c = 0; c < channels; ++c) {
      uint8_t *left = beside.data() + c * width;
      const uint8_t *value = here.data() + c * width;
      left[0] = value[0];
      subtract(value + 1, value, left + 1, width - 1);
      subtract(left, above.data() + c * width, numbers + c * plane + static_cast<int64_t>(y) * width, width);
    }
    beside.swap(above);
  }
}

void restore(const uint8_t *numbers, const FrogPixels &pixels) {
  const int32_t width = pixels.width, channels = pixels.channels;
  const int64_t plane = static_cast<int64_t>(pixels.height) * width;
  std::vector<uint8_t> beside(width * channels, 0), here(width * channels);
  for (int32_t y = 0; y < pixels.height; ++y) {
    for (int32_t c = 0; c < channels; ++c) {
      uint8_t *left = beside.data() + c * width, *value = here.data() + c * width, sum = 0;
      add(left, numbers + c * plane + static_cast<int64_t>(y) * width, width);
      for (int32_t x = 0; x < width; ++x) value[x] = sum += left[x];
    }
    uint8_t *row = pixels.first + y * pixels.row;
    if (channels == 3)
      merge(planes_at(here.data(), width), width, row);
    else
      std::copy(here.begin(), here.end(), row);
  }
}

void predict_details(const FrogPixels &pixels, const FrogPixels &half, uint8_t *numbers) {
  const int32_t width = half.width;
  const int64_t plane = static_cast<int64_t>(half.height) * width;
  std::vector<uint8_t> known(3 * width), found(3 * 2 * width);
  for (int32_t y = 0; y < half.height; ++y) {
    split(half.first + y * half.row, width, planes_at(known.data(), width));
    for (int32_t line = 0; line < 2; ++line) {
      split(pixels.first + (2 * y + line) * pixels.row, 2 * width, planes_at(found.data(), 2 * width));
      for (int32_t side = 0; side < 2; ++side)
        for (int32_t c = 0; c < 3; ++c) {
          const uint8_t *value = found.data() + 2 * c * width + side, *less = known.data() + c * width;
          uint8_t *number = numbers + ((2 * line + side) * 3 + c) * plane + static_cast<int64_t>(y) * width;
          for (int32_t x = 0; x < width; ++x) number[x] = value[2 * x] - less[x];
        }
    }
    for (int32_t quarter = 0; quarter < 3; ++quarter)
      for (int32_t c = 0; c < 3; ++c) {
        const int64_t row = static_cast<int64_t>(y) * width;
        add(numbers + (9 + c) * plane + row, numbers + (3 * quarter + c) * plane + row, width);
      }
  }
}

void restore_details(const uint8_t *numbers, const FrogPixels &half, const FrogPixels &pixels) {
  const int32_t width = half.width;
  const int64_t plane = static_cast<int64_t>(half.height) * width;
  std::vector<uint8_t> known(3 * width), last(3 * width), found(3 * 2 * width);
  for (int32_t y = 0; y < half.height; ++y) {
    split(half.first + y * half.row, width, planes_at(known.data(), width));
    const uint8_t *row = numbers + static_cast<int64_t>(y) * width;
    for (int32_t c = 0; c < 3; ++c)
      for (int32_t x = 0; x < width; ++x)
        last[c * width + x] = row[(9 + c) * plane + x] - row[c * plane + x] - row[(3 + c) * plane + x] -
                              row[(6 + c) * plane + x];
    for (int32_t line = 0; line < 2; ++line) {
      for (int32_t side = 0; side < 2; ++side)
        for (int32_t c = 0; c < 3; ++c) {
          const int32_t quarter = 2 * line + side;
          const uint8_t *number = quarter == 3 ? last.data() + c * width : row + (3 * quarter + c) * plane;
          const uint8_t *more = known.data() + c * width;
          uint8_t *value = found.data() + 2 * c * width + side;
          for (int32_t x = 0; x < width; ++x) value[2 * x] = number[x] + more[x];
        }
      merge(planes_at(found.data(), 2 * width), 2 * width, pixels.first + (2 * y + line) * pixels.row);
    }
  }
}

}  // namespace frog
