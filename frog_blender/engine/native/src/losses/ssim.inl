// Structural similarity of two images and its gradient, for a strip of rows of one channel (window of 11 pixels, sigma
// 1.5, zero outside the image, as 3DGS has it). A strip computes the rows around it that it needs by itself.

constexpr int SSIM_REACH = 5;
constexpr int SSIM_ROWS = SSIM_STRIP + 4 * SSIM_REACH;  // of the images that a strip looks at
constexpr int SSIM_MOMENTS = 5;                         // x, y, x^2, y^2, xy
constexpr int SSIM_SLOPES = 3;                          // by the means of x, x^2 and xy

static_assert(LANES <= 16 && 2 * SSIM_REACH <= 16, "what a row has beyond the image");
// Rows are so long that whole registers may be read and written beyond the image.
static inline long long ssim_row(int width) { return (width + 15) / 16 * 16 + 16; }

static long long ssim_scratch(int width) {
  return ssim_row(width) *
         (2 * SSIM_ROWS + SSIM_MOMENTS * SSIM_ROWS + 2 * SSIM_SLOPES * SSIM_ROWS + SSIM_MOMENTS + SSIM_SLOPES);
}

// out[i] = sum_k window[k] (from[i + k]), along a row that begins SSIM_REACH before the image.
static inline void blur_row(const float *window, const float *from, int width, float *out) {
  for (int i = 0; i < width; i += LANES) {
    Floats sum = {};
    for (int k = 0; k <= 2 * SSIM_REACH; ++k) sum += window[k] * load(from + i + k);
    store(out + i, sum);
  }
}

static inline void blur_column(const float *window, const float *rows, long long row_length, int width, float *out) {
  for (int i = 0; i < width; i += LANES) {
    Floats sum = {};
    for (int k = 0; k <= 2 * SSIM_REACH; ++k) sum += window[k] * load(rows + k * row_length + i);
    store(out + i, sum);
  }
}

// Adds up the similarity over the strip's pixels and writes the gradient of that sum by `image`.
static double ssim(int height, int width, const float *image, const float *truth, int channel, int begin, int end,
                   float *gradient, float *scratch) {
  float window[2 * SSIM_REACH + 1], total = 0;
  for (int k = 0; k <= 2 * SSIM_REACH; ++k)
    total += window[k] = expf(-(k - SSIM_REACH) * (k - SSIM_REACH) / (2 * 1.5f * 1.5f));
  for (float &w : window) w /= total;
  const float c1 = 0.01f * 0.01f, c2 = 0.03f * 0.03f;
  const long long row = ssim_row(width);
  float *x = scratch, *y = x + SSIM_ROWS * row, *moments = y + SSIM_ROWS * row;
  float *slopes = moments + SSIM_MOMENTS * SSIM_ROWS * row, *blurred = slopes + SSIM_SLOPES * SSIM_ROWS * row;
  float *products = blurred + SSIM_SLOPES * SSIM_ROWS * row,
        *sums = products;  // SSIM_MOMENTS rows, one after the other in use
  float *back = products + SSIM_MOMENTS * row;

  const int first = begin - 2 * SSIM_REACH, rows = end - begin + 4 * SSIM_REACH;
  for (int r = 0; r < rows; ++r) {
    float *xs = x + r * row, *ys = y + r * row;
    const int line = first + r;
    for (long long i = 0; i < row; ++i) xs[i] = ys[i] = 0;
    if (line >= 0 && line < height)
      for (int i = 0; i < width; ++i) {
        const long long at = (static_cast<long long>(line) * width + i) * 3 + channel;
        xs[i + SSIM_REACH] = image[at];
        ys[i + SSIM_REACH] = truth[at];
      }
    for (long long i = 0; i < row; ++i) {
      products[i] = xs[i] * xs[i];
      products[row + i] = ys[i] * ys[i];
      products[2 * row + i] = xs[i] * ys[i];
    }
    const float *from[SSIM_MOMENTS] = {xs, ys, products, products + row, products + 2 * row};
    for (int m = 0; m < SSIM_MOMENTS; ++m) blur_row(window, from[m], width, moments + (m * SSIM_ROWS + r) * row);
  }

  double similar = 0;
  for (int r = 0; r < rows - 2 * SSIM_REACH; ++r) {
    const int line = first + SSIM_REACH + r;
    float *by[SSIM_SLOPES];
    for (int s = 0; s < SSIM_SLOPES; ++s) {
      by[s] = slopes + (s * SSIM_ROWS + r) * row;
      for (long long i = 0; i < row; ++i) by[s][i] = 0;
    }
    if (line >= 0 && line < height) {
      for (int m = 0; m < SSIM_MOMENTS; ++m)
        blur_column(window, moments + (m * SSIM_ROWS + r) * row, row, width, sums + m * row);
      const float *mx = sums, *my = sums + row, *xx = sums + 2 * row, *yy = sums + 3 * row, *xy = sums + 4 * row;
      float here = 0;
      for (int i = 0; i < width; ++i) {
        const float a1 = 2 * mx[i] * my[i] + c1, a2 = 2 * (xy[i] - mx[i] * my[i]) + c2;
        const float b1 = mx[i] * mx[i] + my[i] * my[i] + c1, b2 = xx[i] - mx[i] * mx[i] + yy[i] - my[i] * my[i] + c2;
        const float value = a1 * a2 / (b1 * b2);
        here += value;
        by[0][i + SSIM_REACH] = 2 * my[i] * (a2 - a1) / (b1 * b2) + 2 * mx[i] * value * (1 / b2 - 1 / b1);
        by[1][i + SSIM_REACH] = -value / b2;
        by[2][i + SSIM_REACH] = 2 * a1 / (b1 * b2);
      }
      if (line >= begin && line < end) similar += here;
    }
    for (int s = 0; s < SSIM_SLOPES; ++s) blur_row(window, by[s], width, blurred + (s * SSIM_ROWS + r) * row);
  }

  for (int r = 0; r < end - begin; ++r) {
    for (int s = 0; s < SSIM_SLOPES; ++s)
      blur_column(window, blurred + (s * SSIM_ROWS + r) * row, row, width, back + s * row);
    const float *xs = x + (r + 2 * SSIM_REACH) * row + SSIM_REACH, *ys = y + (r + 2 * SSIM_REACH) * row + SSIM_REACH;
    for (int i = 0; i < width; ++i)
      gradient[(static_cast<long long>(begin + r) * width + i) * 3 + channel] =
          back[i] + 2 * xs[i] * back[row + i] + ys[i] * back[2 * row + i];
  }
  return similar;
}
