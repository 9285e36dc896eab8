// A drawing against the image it should be, a row of cells at a time: each number is read once.

struct DifferenceSums {
  Floats absolute = {}, square = {};
};

struct PixelRow {
  const float *image;
  const uint8_t *truth;
  float *gradient, *truth_floats;
};

// Takes in `count` numbers, LANES at most.
static inline void compare_numbers(const PixelRow &row, int at, int count, float share, DifferenceSums &sums) {
  Floats drawn = {};
  int32_t bytes[LANES] = {};
  __builtin_memcpy(&drawn, row.image + at, count * sizeof(float));
  for (int i = 0; i < count; ++i) bytes[i] = row.truth[at + i];
  const Floats whole = __builtin_convertvector(load(bytes), Floats), about = whole * (1 / 255.0f);
  const Floats wanted = about + (whole - about * 255.0f) * (1 / 255.0f);  // rounded as a division, which takes longer
  const Floats difference = drawn - wanted;
  const Floats sign = __builtin_convertvector((difference < 0.0f) - (difference > 0.0f), Floats);  // true is -1
  const Floats slope = sign * share;
  sums.absolute += sign * difference;
  sums.square += difference * difference;
  __builtin_memcpy(row.gradient + at, &slope, count * sizeof(float));
  if (row.truth_floats) __builtin_memcpy(row.truth_floats + at, &wanted, count * sizeof(float));
}

// Returns the sum of the absolute differences of a row of cells.
static double l1_loss(const FrogL1Loss &c, int row) {
  const int numbers = 3 * c.width, top = row * FROG_CELL,
            bottom = top + FROG_CELL < c.height ? top + FROG_CELL : c.height;
  const float share = c.weight / (static_cast<float>(numbers) * c.height);
  double absolute = 0;
  for (int begin = 0, cell = row * ((c.width + FROG_CELL - 1) / FROG_CELL); begin < numbers;
       begin += 3 * FROG_CELL, ++cell) {
    const int end = begin + 3 * FROG_CELL < numbers ? begin + 3 * FROG_CELL : numbers;
    DifferenceSums sums;
    for (int line = top; line < bottom; ++line) {
      const long long first = static_cast<long long>(line) * numbers;
      const PixelRow pixels = {c.image + first, c.truth + line * c.truth_row, c.gradient + first,
                               c.truth_floats ? c.truth_floats + first : nullptr};
      int at = begin;
      for (; at + LANES <= end; at += LANES) compare_numbers(pixels, at, LANES, share, sums);
      if (at < end) compare_numbers(pixels, at, end - at, share, sums);
    }
    absolute += sum(sums.absolute);
    c.cells[cell] = sum(sums.square) / (static_cast<float>(end - begin) * (bottom - top));
  }
  return absolute;
}
