// Numbers of tiles of images that compress well, and back, without loss: see frog_native.h. `scratch` has TILE_SCRATCH
// bytes for each column of a tile, of details for each column of the reduced image.

struct Planes {
  uint8_t *green, *red, *blue;
};

// A row of red, green and blue as planes, and back.
static inline void split(const uint8_t *__restrict pixels, int32_t width, const Planes &planes) {
  uint8_t *__restrict greens = planes.green, *__restrict reds = planes.red, *__restrict blues = planes.blue;
  for (int32_t x = 0; x < width; ++x) {
    const uint8_t green = pixels[3 * x + 1];
    greens[x] = green;
    reds[x] = pixels[3 * x] - green;
    blues[x] = pixels[3 * x + 2] - green;
  }
}

static inline void merge(const Planes &planes, int32_t width, uint8_t *__restrict pixels) {
  for (int32_t x = 0; x < width; ++x) {
    const uint8_t green = planes.green[x];
    pixels[3 * x] = planes.red[x] + green;
    pixels[3 * x + 1] = green;
    pixels[3 * x + 2] = planes.blue[x] + green;
  }
}

// Three planes one after the other.
static inline Planes planes_at(uint8_t *first, int64_t plane) { return {first, first + plane, first + 2 * plane}; }

static inline void add(uint8_t *__restrict sum, const uint8_t *__restrict numbers, int32_t count) {
  for (int32_t i = 0; i < count; ++i) sum[i] += numbers[i];
}

static inline void subtract(const uint8_t *of, const uint8_t *numbers, uint8_t *__restrict difference, int32_t count) {
  for (int32_t i = 0; i < count; ++i) difference[i] = of[i] - numbers[i];
}

static void predict(const FrogPixels &pixels, const FrogPixels &, uint8_t *numbers, uint8_t *scratch) {
  const int32_t width = pixels.width, channels = pixels.channels;
  const int64_t plane = static_cast<int64_t>(pixels.height) * width;
  uint8_t *beside = scratch, *above = beside + width * channels, *here = above + width * channels;
  for (int32_t i = 0; i < width * channels; ++i) above[i] = 0;
  for (int32_t y = 0; y < pixels.height; ++y) {
    const uint8_t *row = pixels.first + y * pixels.row;
    if (channels == 3)
      split(row, width, planes_at(here, width));
    else
      for (int32_t x = 0; x < width; ++x) here[x] = row[x];
    for (int32_t c = 0; c < channels; ++c) {
      uint8_t *left = beside + c * width;
      const uint8_t *value = here + c * width;
      left[0] = value[0];
      subtract(value + 1, value, left + 1, width - 1);
      subtract(left, above + c * width, numbers + c * plane + static_cast<int64_t>(y) * width, width);
    }
    uint8_t *free = above;
    above = beside;
    beside = free;
  }
}

static void restore(const FrogPixels &pixels, const FrogPixels &, const uint8_t *numbers, uint8_t *scratch) {
  const int32_t width = pixels.width, channels = pixels.channels;
  const int64_t plane = static_cast<int64_t>(pixels.height) * width;
  uint8_t *beside = scratch, *here = beside + width * channels;
  for (int32_t i = 0; i < width * channels; ++i) beside[i] = 0;
  for (int32_t y = 0; y < pixels.height; ++y) {
    for (int32_t c = 0; c < channels; ++c) {
      uint8_t *left = beside + c * width, *value = here + c * width, sum = 0;
      add(left, numbers + c * plane + static_cast<int64_t>(y) * width, width);
      for (int32_t x = 0; x < width; ++x) value[x] = sum += left[x];
    }
    uint8_t *row = pixels.first + y * pixels.row;
    if (channels == 3)
      merge(planes_at(here, width), width, row);
    else
      for (int32_t x = 0; x < width; ++x) row[x] = here[x];
  }
}

static void predict_details(const FrogPixels &pixels, const FrogPixels &half, uint8_t *numbers, uint8_t *scratch) {
  const int32_t width = half.width;
  const int64_t plane = static_cast<int64_t>(half.height) * width;
  uint8_t *known = scratch, *found = known + 3 * width;
  for (int32_t y = 0; y < half.height; ++y) {
    split(half.first + y * half.row, width, planes_at(known, width));
    for (int32_t line = 0; line < 2; ++line) {
      split(pixels.first + (2 * y + line) * pixels.row, 2 * width, planes_at(found, 2 * width));
      for (int32_t side = 0; side < 2; ++side)
        for (int32_t c = 0; c < 3; ++c) {
          const uint8_t *value = found + 2 * c * width + side, *less = known + c * width;
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

static void restore_details(const FrogPixels &pixels, const FrogPixels &half, const uint8_t *numbers,
                            uint8_t *scratch) {
  const int32_t width = half.width;
  const int64_t plane = static_cast<int64_t>(half.height) * width;
  uint8_t *known = scratch, *last = known + 3 * width, *found = last + 3 * width;
  for (int32_t y = 0; y < half.height; ++y) {
    split(half.first + y * half.row, width, planes_at(known, width));
    const uint8_t *row = numbers + static_cast<int64_t>(y) * width;
    for (int32_t c = 0; c < 3; ++c)
      for (int32_t x = 0; x < width; ++x)
        last[c * width + x] = row[(9 + c) * plane + x] - row[c * plane + x] - row[(3 + c) * plane + x] -
                              row[(6 + c) * plane + x];
    for (int32_t line = 0; line < 2; ++line) {
      for (int32_t side = 0; side < 2; ++side)
        for (int32_t c = 0; c < 3; ++c) {
          const int32_t quarter = 2 * line + side;
          const uint8_t *number = quarter == 3 ? last + c * width : row + (3 * quarter + c) * plane;
          const uint8_t *more = known + c * width;
          uint8_t *value = found + 2 * c * width + side;
          for (int32_t x = 0; x < width; ++x) value[2 * x] = number[x] + more[x];
        }
      merge(planes_at(found, 2 * width), 2 * width, pixels.first + (2 * y + line) * pixels.row);
    }
  }
}
