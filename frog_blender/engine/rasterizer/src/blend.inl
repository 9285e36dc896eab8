// Front-to-back blending of one tile, and its gradients by the same walk.
//
// A pixel is finished by the Gaussian that would take its transmittance below TRANSMITTANCE_MIN (that one is left out).
// A finished pixel keeps its transmittance with the sign flipped, which fails every later test by itself.

constexpr float LOG2E = 1.4426950408889634f;
constexpr int VECTORS = TILE / LANES;  // a row of the tile
static_assert(TILE % LANES == 0, "a tile row is a whole number of vectors");

// The part of a tile that one splat's bounding box touches: rows, and vectors of columns.
struct Footprint {
  int first_row, last_row, first_vector, last_vector;
};

static inline Footprint footprint_of(const Splat &splat, const Tile &tile, int height) {
  constexpr float MARGIN = 0.01f;  // pixels, for rounding; every pixel is tested anyway
  const int rows = height - tile.y * TILE < TILE ? height - tile.y * TILE : TILE;
  const float x = splat.x - tile.x * TILE - 0.5f, y = splat.y - tile.y * TILE - 0.5f;  // in pixel centres
  const float reach_x = splat.extent_x + MARGIN, reach_y = splat.extent_y + MARGIN;
  Footprint f;
  // Conversion truncates, which only ever adds a row or a vector.
  f.first_row = static_cast<int>(clamped(y - reach_y, 0, TILE));
  f.last_row = static_cast<int>(clamped(y + reach_y + 1, 0, static_cast<float>(rows))) - 1;
  f.first_vector = static_cast<int>(clamped(x - reach_x, 0, TILE)) / LANES;
  f.last_vector = static_cast<int>(clamped(x + reach_x, -1, TILE - 1) + LANES) / LANES - 1;
  return f;
}

static inline Floats column_offsets(const Splat &splat, const Tile &tile, int vector) {
  static const float ramp[16] = {0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15};
  return load(ramp + vector * LANES) + (tile.x * TILE + 0.5f - splat.x);
}

// Logarithm to base 2 of the splat's alpha along a row: quadratic + linear dx + offset.
struct RowTerms {
  float dy, linear, offset;
};

static inline RowTerms row_terms(const Splat &splat, const Tile &tile, int row, float log2_opacity) {
  const float dy = tile.y * TILE + row + 0.5f - splat.y;
  return {dy, -LOG2E * splat.b * dy, -0.5f * LOG2E * splat.c * dy * dy + log2_opacity};
}

constexpr float LOG2_ALPHA_MIN = -7.994353436858858f;  // log2(1 / 255)

static inline void raise_to(float *target, float value) {  // atomic maximum of non-negative floats: any order, same result
  int32_t old = __atomic_load_n(reinterpret_cast<int32_t *>(target), __ATOMIC_RELAXED), wanted;
  __builtin_memcpy(&wanted, &value, 4);
  while (old < wanted && !__atomic_compare_exchange_n(reinterpret_cast<int32_t *>(target), &old, wanted, true,
                                                      __ATOMIC_RELAXED, __ATOMIC_RELAXED)) {
  }
}

static inline bool finished(const float *transmittance) {
  Ints open = {};
  for (int i = 0; i < TILE * TILE; i += LANES) open |= load(transmittance + i) > 0.0f;
  return !any(open);
}

template <bool DEPTH, bool WEIGHTS>
static void blend_tile(const FrameView &view, const Tile &tile, const FrogImage &image) {
  alignas(64) float transmittance[TILE * TILE], red[TILE * TILE] = {}, green[TILE * TILE] = {}, blue[TILE * TILE] = {};
  alignas(64) float depth[DEPTH ? TILE * TILE : 1] = {};
  alignas(64) int32_t median[DEPTH ? TILE * TILE : 1];
  const int width = view.camera.width, height = view.camera.height;
  const int columns = width - tile.x * TILE < TILE ? width - tile.x * TILE : TILE;
  const int rows = height - tile.y * TILE < TILE ? height - tile.y * TILE : TILE;
  // Pixels outside the picture start finished.
  for (int i = 0; i < TILE * TILE; ++i) transmittance[i] = i % TILE < columns && i / TILE < rows ? 1.0f : -1.0f;
  if (DEPTH) for (int i = 0; i < TILE * TILE; ++i) median[i] = -1;

  for (uint32_t n = tile.begin; n < tile.end; ++n) {
    if ((n - tile.begin) % 16 == 15 && finished(transmittance)) break;
    __builtin_prefetch(view.splats + view.tile_splats[n + 4 < tile.end ? n + 4 : n]);
    const uint32_t index = view.tile_splats[n];
    const Splat &splat = view.splats[index];
    const Footprint f = footprint_of(splat, tile, height);
    const float log2_opacity = LOG2_ALPHA_MIN + 0.5f * LOG2E * splat.cutoff;
    Floats heaviest = {};
    for (int v = f.first_vector; v <= f.last_vector; ++v) {
      const Floats dx = column_offsets(splat, tile, v), quadratic = dx * dx * (-0.5f * LOG2E * splat.a);
      for (int row = f.first_row; row <= f.last_row; ++row) {
        const RowTerms terms = row_terms(splat, tile, row, log2_opacity);
        const Floats power = quadratic + dx * terms.linear + terms.offset;
        const int at = row * TILE + v * LANES;
        const Floats t = load(transmittance + at);
        const Ints drawn = (power >= LOG2_ALPHA_MIN) & (t > 0.0f);
        if (!any(drawn)) continue;
        Floats alpha = exp2_nonpositive(power);
        alpha = alpha < ALPHA_MAX ? alpha : all(ALPHA_MAX);
        const Floats next = t - t * alpha;
        const Ints blended = drawn & (next >= TRANSMITTANCE_MIN);
        const Floats weight = blended ? t * alpha : Floats{};
        store(red + at, load(red + at) + weight * splat.red);
        store(green + at, load(green + at) + weight * splat.green);
        store(blue + at, load(blue + at) + weight * splat.blue);
        store(transmittance + at, blended ? next : (drawn ? -t : t));
        if (DEPTH) {
          store(depth + at, load(depth + at) + weight * splat.depth);
          const Ints crossing = blended & (t > 0.5f) & (next <= 0.5f);
          store(median + at, crossing ? static_cast<int32_t>(index) - Ints{} : load(median + at));
        }
        if (WEIGHTS) heaviest = weight > heaviest ? weight : heaviest;
      }
    }
    if (WEIGHTS) {
      const float weight = largest(heaviest);
      if (weight > 0) raise_to(image.max_weights + index, weight);
    }
  }

  for (int row = 0; row < rows; ++row)
    for (int column = 0; column < columns; ++column) {
      const int from = row * TILE + column;
      const long to = static_cast<long>(tile.y * TILE + row) * width + tile.x * TILE + column;
      const float left = __builtin_fabsf(transmittance[from]);
      image.rgb[3 * to] = red[from] + left * view.options.background[0];
      image.rgb[3 * to + 1] = green[from] + left * view.options.background[1];
      image.rgb[3 * to + 2] = blue[from] + left * view.options.background[2];
      image.alpha[to] = 1 - left;
      if (DEPTH) {
        image.median_index[to] = median[from];
        image.mean_depth[to] = left < 1 ? depth[from] / (1 - left) : __builtin_nanf("");
      }
    }
}

static void blend(const FrameView &view, const Tile &tile, const FrogImage &image) {
  const bool depth = view.options.want_depth, weights = view.options.want_weights;
  if (depth && weights) blend_tile<true, true>(view, tile, image);
  else if (depth) blend_tile<true, false>(view, tile, image);
  else if (weights) blend_tile<false, true>(view, tile, image);
  else blend_tile<false, false>(view, tile, image);
}

// Picture C = sum w_i c_i + T_end background, alpha A = 1 - T_end. With g = dL/dC and h = dL/dA, the part of the loss
// that lies behind Gaussian i is rest_i = sum_{j > i} w_j g.c_j + T_end (g.background - h); it starts as
// g.C - h T_end and loses w_i g.c_i at each step. Then dL/dalpha_i = T_i g.c_i - rest_i / (1 - alpha_i).
static void blend_backward(const FrameView &view, const Tile &tile, const FrogImage &image,
                           const FrogImageGradient &gradient) {
  alignas(64) float transmittance[TILE * TILE], rest[TILE * TILE] = {};
  alignas(64) float red[TILE * TILE] = {}, green[TILE * TILE] = {}, blue[TILE * TILE] = {};  // dL/dC
  const int width = view.camera.width, height = view.camera.height;
  for (int i = 0; i < TILE * TILE; ++i) {
    const int x = tile.x * TILE + i % TILE, y = tile.y * TILE + i / TILE;
    transmittance[i] = -1;
    if (x >= width || y >= height) continue;
    const long at = static_cast<long>(y) * width + x;
    transmittance[i] = 1;
    red[i] = gradient.rgb[3 * at], green[i] = gradient.rgb[3 * at + 1], blue[i] = gradient.rgb[3 * at + 2];
    rest[i] = red[i] * image.rgb[3 * at] + green[i] * image.rgb[3 * at + 1] + blue[i] * image.rgb[3 * at + 2] -
              gradient.alpha[at] * (1 - image.alpha[at]);
  }

  for (uint32_t n = tile.begin; n < tile.end; ++n) {
    float *out = view.instance_gradients + static_cast<size_t>(view.tile_slots[n]) * INSTANCE_GRADIENTS;
    if ((n - tile.begin) % 16 == 15 && finished(transmittance)) return;  // the slots were zeroed when allocated
    __builtin_prefetch(view.splats + view.tile_splats[n + 4 < tile.end ? n + 4 : n]);
    const Splat &splat = view.splats[view.tile_splats[n]];
    const Footprint f = footprint_of(splat, tile, height);
    const float log2_opacity = LOG2_ALPHA_MIN + 0.5f * LOG2E * splat.cutoff;
    Floats s_0 = {}, s_x = {}, s_xx = {}, s_y = {}, s_xy = {}, s_yy = {}, by_red = {}, by_green = {}, by_blue = {};
    for (int v = f.first_vector; v <= f.last_vector; ++v) {
      const Floats dx = column_offsets(splat, tile, v), quadratic = dx * dx * (-0.5f * LOG2E * splat.a);
      // Moments of dL/dpower down the columns; dx is constant along each.
      Floats m0 = {}, m1 = {}, m2 = {};
      for (int row = f.first_row; row <= f.last_row; ++row) {
        const RowTerms terms = row_terms(splat, tile, row, log2_opacity);
        const Floats power = quadratic + dx * terms.linear + terms.offset;
        const int at = row * TILE + v * LANES;
        const Floats t = load(transmittance + at);
        const Ints drawn = (power >= LOG2_ALPHA_MIN) & (t > 0.0f);
        if (!any(drawn)) continue;
        const Floats raw = exp2_nonpositive(power);
        const Floats alpha = raw < ALPHA_MAX ? raw : all(ALPHA_MAX);
        const Floats next = t - t * alpha;
        const Ints blended = drawn & (next >= TRANSMITTANCE_MIN);
        const Floats weight = blended ? t * alpha : Floats{};
        store(transmittance + at, blended ? next : (drawn ? -t : t));
        const Floats g_red = load(red + at), g_green = load(green + at), g_blue = load(blue + at);
        const Floats g_colour = g_red * splat.red + g_green * splat.green + g_blue * splat.blue;
        const Floats behind = load(rest + at) - weight * g_colour;
        store(rest + at, behind);
        by_red += weight * g_red;
        by_green += weight * g_green;
        by_blue += weight * g_blue;
        const Floats by_alpha = t * g_colour - behind / (1.0f - alpha);
        // alpha = opacity exp(power): dL/dpower = dL/dalpha alpha; a clamped alpha passes nothing on.
        const Floats by_power = (blended & (raw < ALPHA_MAX)) ? by_alpha * alpha : Floats{};
        m0 += by_power;
        m1 += by_power * terms.dy;
        m2 += by_power * (terms.dy * terms.dy);
      }
      s_0 += m0;
      s_x += m0 * dx;
      s_xx += m0 * dx * dx;
      s_y += m1;
      s_xy += m1 * dx;
      s_yy += m2;
    }
    const float sx = sum(s_x), sy = sum(s_y);
    out[0] = splat.a * sx + splat.b * sy;
    out[1] = splat.b * sx + splat.c * sy;
    out[2] = -0.5f * sum(s_xx);
    out[3] = -sum(s_xy);
    out[4] = -0.5f * sum(s_yy);
    out[5] = sum(s_0) / splat.opacity;
    out[6] = sum(by_red);
    out[7] = sum(by_green);
    out[8] = sum(by_blue);
  }
}
