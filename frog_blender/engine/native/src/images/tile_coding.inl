// Numbers of tiles of images that compress well, and back, without loss: see frog_native.h. `scratch` has TILE_SCRATCH
// bytes for each column of a tile.

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

static void predict(const FrogPixels &pixels, uint8_t *numbers, uint8_t *scratch) {
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

static void restore(const FrogPixels &pixels, const uint8_t *numbers, uint8_t *scratch) {
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
