// Gradients of one tile, by the same walk front to back.
//
// Picture C = sum w_i c_i + T_end background, alpha A = 1 - T_end. With g = dL/dC and h = dL/dA, the part of the loss
// that lies behind Gaussian i is rest_i = sum_{j > i} w_j g.c_j + T_end (g.background - h); it starts as
// g.C - h T_end and loses w_i g.c_i at each step. Then dL/dalpha_i = T_i g.c_i - rest_i / (1 - alpha_i), and
// dL/dlog(alpha_i) = w_i g.c_i - rest_i alpha_i / (1 - alpha_i).

static inline float *slot_of(const SlotView &slots, const Instance &instance) {
  // The sum wraps on purpose, see place_slots.
  const uint32_t slot = slots.moved ? instance.slot + slots.moved[instance.splat] : instance.slot;
  return slots.gradients + static_cast<size_t>(slot) * slots.width;
}

// What a tile's pixels hold in this walk.
template <bool LIMIT>
struct alignas(64) BackwardPixels {
  float transmittance[TILE_PIXELS], rest[TILE_PIXELS] = {};
  float red[TILE_PIXELS] = {}, green[TILE_PIXELS] = {}, blue[TILE_PIXELS] = {};  // dL/dC
  float limit[LIMIT ? TILE_PIXELS : 1];
};

template <bool LIMIT>
static inline void open_backward(const FrameView &view, const Tile &tile, const TileSize &size, const FrogImage &image,
                                 const FrogImageGradient &gradient, BackwardPixels<LIMIT> &p) {
  open_tile(view, tile, p.transmittance, LIMIT ? p.limit : nullptr);
  for (int row = 0; row < size.rows; ++row) {
    long long at = picture_index(view, tile, row * TILE);
    for (int i = row * TILE; i < row * TILE + size.columns; ++i, ++at) {
      p.red[i] = gradient.rgb[3 * at], p.green[i] = gradient.rgb[3 * at + 1], p.blue[i] = gradient.rgb[3 * at + 2];
      p.rest[i] = p.red[i] * image.rgb[3 * at] + p.green[i] * image.rgb[3 * at + 1] + p.blue[i] * image.rgb[3 * at + 2];
      if (gradient.alpha) p.rest[i] -= gradient.alpha[at] * (1 - image.alpha[at]);
    }
  }
}

// Sums over pixels of g = dL/dlog(alpha), with d = row - middle row and s = u in the middle row, u = s + lean d. In a
// column s is one number, so that three sums a pixel are enough; the middle row keeps both small.
enum ColumnSum { OF_1, OF_D, OF_DD, OF_S, OF_SD, OF_SS, OF_RED, OF_GREEN, OF_BLUE, OF_ABSOLUTE_X, OF_ABSOLUTE_Y, COLUMN_SUMS };

template <bool LIMIT, bool ABSOLUTE, bool OPAQUE>
static inline void sum_columns(const Splat &splat, const Footprint &f, int middle, const uint32_t *open,
                               BackwardPixels<LIMIT> &p, Floats *sums) {
  const float *from_middle = offsets_from(middle);
  for (size_t v = 0; v < COLUMNS; ++v) {
    const Floats along = columns_of(f, v) * splat.along, start = along + f.shift[middle];
    Floats by_1 = {}, by_d = {}, by_dd = {};
    for (uint32_t rows = f.rows[v] & open[v]; rows; rows &= rows - 1) {
      const size_t row = lowest(rows), at = row * TILE + v * LANES;
      const float d = from_middle[row];
      const Floats u = along + f.shift[row], power = f.constant[row] - u * u;
      const Floats t = load(p.transmittance + at);
      Contribution c;
      contribution_of<LIMIT, OPAQUE>(power, t, splat.depth, p.limit + (LIMIT ? at : 0), c);
      store(p.transmittance + at, c.next);
      const Floats g_red = load(p.red + at), g_green = load(p.green + at), g_blue = load(p.blue + at);
      const Floats own = c.weight * (g_red * splat.red + g_green * splat.green + g_blue * splat.blue);
      const Floats behind = load(p.rest + at) - own;
      store(p.rest + at, behind);
      sums[OF_RED] += c.weight * g_red;
      sums[OF_GREEN] += c.weight * g_green;
      sums[OF_BLUE] += c.weight * g_blue;
      // alpha / (1 - alpha) = weight / transmittance behind. A clamped alpha passes nothing on.
      const Mask passes = OPAQUE ? and_not(c.blended, at_least(c.raw, all(ALPHA_MAX))) : c.blended;
      const Floats g = keep(passes, own - behind * (c.weight / c.behind));
      const Floats times_d = g * d;
      by_1 += g;
      by_d += times_d;
      by_dd += times_d * d;
      if (ABSOLUTE) {  // d(log alpha)/d(position)
        const Floats by_u = g * u;
        sums[OF_ABSOLUTE_X] += absolute(by_u * (2 / LOG2E * splat.along));
        sums[OF_ABSOLUTE_Y] += absolute((by_u * splat.lean + g * f.v[row] * splat.across) * (2 / LOG2E));
      }
    }
    const Floats by_s = by_1 * start;
    sums[OF_1] += by_1;
    sums[OF_D] += by_d;
    sums[OF_DD] += by_dd;
    sums[OF_S] += by_s;
    sums[OF_SD] += by_d * start;
    sums[OF_SS] += by_s * start;
  }
}

static inline int middle_row(const Footprint &f) {
  uint32_t rows = 0;
  for (int c = 0; c < COLUMNS; ++c) rows |= f.rows[c];
  return rows ? (__builtin_ctz(rows) + 31 - __builtin_clz(rows)) / 2 : 0;
}

// From sums over columns to the moments of SplatGradient; v is v0 in the middle row.
template <bool ABSOLUTE>
static inline void moments_of(const Floats *sums, const Splat &splat, float v0, float *out) {
  float of[8];
  sums_of_8(sums, of);
  const float by_ud = of[OF_SD] + splat.lean * of[OF_DD];
  out[SUM_1] = of[OF_1];
  out[SUM_U] = of[OF_S] + splat.lean * of[OF_D];
  out[SUM_V] = v0 * of[OF_1] + splat.across * of[OF_D];
  out[SUM_UU] = of[OF_SS] + splat.lean * (of[OF_SD] + by_ud);
  out[SUM_UV] = v0 * out[SUM_U] + splat.across * by_ud;
  out[SUM_VV] = v0 * out[SUM_V] + splat.across * (v0 * of[OF_D] + splat.across * of[OF_DD]);
  out[BY_RED] = of[OF_RED];
  out[BY_GREEN] = of[OF_GREEN];
  out[BY_BLUE] = sum(sums[OF_BLUE]);
  if (!ABSOLUTE) return;
  out[ABSOLUTE_X] = sum(sums[OF_ABSOLUTE_X]);
  out[ABSOLUTE_Y] = sum(sums[OF_ABSOLUTE_Y]);
}

template <bool LIMIT, bool ABSOLUTE>
static void blend_tile_backward(const FrameView &view, const SlotView &slots, const Tile &tile, const FrogImage &image,
                                const FrogImageGradient &gradient) {
  const TileSize size = size_of(view, tile);
  BackwardPixels<LIMIT> pixels;
  open_backward(view, tile, size, image, gradient, pixels);
  Footprints footprints(view, tile);
  uint32_t open[COLUMNS];
  bool over = !still_open(pixels.transmittance, open);

  for (uint32_t n = tile.begin; n < tile.end; ++n) {
    const Instance &instance = view.instances[n], &soon = view.instances[n + 6 < tile.end ? n + 6 : n];
    float *out = slot_of(slots, instance);
    __builtin_prefetch(slot_of(slots, soon), 1);
    over = over || ((n - tile.begin) % CHECK_EVERY == CHECK_EVERY - 1 && !still_open(pixels.transmittance, open));
    if (over) {
      for (int k = 0; k < slots.width; ++k) out[k] = 0;
      continue;
    }
    __builtin_prefetch(view.splats + soon.splat);
    const Splat &splat = view.splats[instance.splat];
    const Footprint &f = footprints.at(n);
    const int middle = middle_row(f);
    Floats sums[COLUMN_SUMS] = {};
    if (is_opaque(splat)) sum_columns<LIMIT, ABSOLUTE, true>(splat, f, middle, open, pixels, sums);
    else sum_columns<LIMIT, ABSOLUTE, false>(splat, f, middle, open, pixels, sums);
    moments_of<ABSOLUTE>(sums, splat, f.v[middle], out);
  }
}

static void blend_backward(const FrameView &view, const SlotView &slots, const Tile &tile, const FrogImage &image,
                           const FrogImageGradient &gradient) {
  const bool limit = view.options.depth_limit, absolute = slots.width == SPLAT_GRADIENTS;
  if (limit && absolute) blend_tile_backward<true, true>(view, slots, tile, image, gradient);
  else if (limit) blend_tile_backward<true, false>(view, slots, tile, image, gradient);
  else if (absolute) blend_tile_backward<false, true>(view, slots, tile, image, gradient);
  else blend_tile_backward<false, false>(view, slots, tile, image, gradient);
}
