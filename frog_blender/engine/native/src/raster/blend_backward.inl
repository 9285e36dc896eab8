// Gradients of one tile: the same splats as in blending, from the last to the first.
//
// Image C = sum w_i c_i + T_end background, alpha A = 1 - T_end. With g = dL/dC and h = dL/dA, the part of the loss
// that lies behind Gaussian i is rest_i = sum_{j > i} w_j g.c_j + T_end (g.background - h); backward it begins
// with its last term and gains w_i g.c_i at each step, and T_i = T_{i+1} / (1 - alpha_i). Then dL/dalpha_i = T_i g.c_i
// - rest_i / (1 - alpha_i), and dL/dlog(alpha_i) = w_i g.c_i - rest_i alpha_i / (1 - alpha_i). On the way out rest
// would begin as the whole image's, and behind opaque Gaussians what is left of it would be its rounding
// (docs/experiments/rasterizer.md).

static inline float *slot_of(const SlotView &slots, const Instance &instance) {
  // The sum wraps on purpose, see place_slots.
  const uint32_t slot = slots.moved ? instance.slot + slots.moved[instance.splat] : instance.slot;
  return slots.gradients + static_cast<size_t>(slot) * SPLAT_GRADIENTS;
}

// What a tile's pixels hold in this walk.
struct alignas(64) BackwardPixels {
  float transmittance[TILE_PIXELS];  // behind the splat whose turn it is
  float rest[TILE_PIXELS] = {};
  float red[TILE_PIXELS] = {}, green[TILE_PIXELS] = {}, blue[TILE_PIXELS] = {};  // dL/dC
  int32_t reached[TILE_PIXELS] = {};
};

// Returns how many of the tile's instances have a pixel that went through them.
static inline uint32_t open_backward(const FrameView &view, const Tile &tile, const FrogImageGradient &gradient,
                                     BackwardPixels &p) {
  const TileSize size = size_of(view, tile);
  const float *background = view.options.background;
  int32_t furthest = 0;
  for (int i = 0; i < TILE_PIXELS; ++i) p.transmittance[i] = 1;  // outside the image, too
  for (int row = 0; row < size.rows; ++row) {
    long long at = image_index(view, tile, row * TILE);
    for (int i = row * TILE; i < row * TILE + size.columns; ++i, ++at) {
      p.red[i] = gradient.rgb[3 * at];
      p.green[i] = gradient.rgb[3 * at + 1];
      p.blue[i] = gradient.rgb[3 * at + 2];
      const float by_left = p.red[i] * background[0] + p.green[i] * background[1] + p.blue[i] * background[2];
      p.transmittance[i] = view.transmittance[at];
      p.rest[i] = (by_left - (gradient.alpha ? gradient.alpha[at] : 0)) * p.transmittance[i];
      p.reached[i] = view.reached[at];
      furthest = p.reached[i] > furthest ? p.reached[i] : furthest;
    }
  }
  return furthest;
}

// Rows of each column of vectors in which a pixel went through more than k of the tile's instances.
static inline void gone_through(const int32_t *reached, int32_t k, uint32_t *rows) {
  rows_where([&](int at) { return above(load(reached + at), k); }, rows);
}

// Adds what the pixels send back, in the order of SplatGradient. In a column u and v depend on the row alone, so three
// sums over its rows, of g = dL/dlog(alpha), g d and g d^2, give all five moments. d counts from where the column comes
// nearest to the splat's axis u = 0: counted from anywhere else, a slanting needle's sums would cancel.
// OPAQUE: whether the splat reaches the clamp of alpha at all, which few do.
template <bool OPAQUE>
static inline void sum_columns(const Splat &splat, const Footprint &f, int32_t k, const uint32_t *open,
                               BackwardPixels &p, Floats *sums) {
  const float over_lean = -1 / splat.lean;
  for (size_t c = 0; c < COLUMNS; ++c) {
    const Floats along = columns_of(f, c) * splat.along, start = along + f.shift[0];
    const Floats nearest =
        larger(smaller(start * over_lean, all(TILE - 1)), Floats{});  // a row; finite whatever lean is
    const Floats u0 = start + splat.lean * nearest, v0 = f.v[0] + splat.across * nearest;
    Floats by_1 = {}, by_d = {}, by_dd = {};
    for (uint32_t rows = f.rows[c] & open[c]; rows; rows &= rows - 1) {
      const size_t row = lowest(rows), at = row * TILE + c * LANES;
      const Floats d = ramp[row] - nearest;
      const Floats u = along + f.shift[row], power = f.constant[row] - u * u;
      const Mask blended = above(at_least(power, all(LOG2_ALPHA_MIN)), load(p.reached + at), k);
      const Floats raw = exp2(power), alpha = OPAQUE ? smaller(raw, all(ALPHA_MAX)) : raw;
      const Floats inverse = 1 / (1 - alpha), behind = load(p.transmittance + at), before = behind * inverse;
      const Floats weight = keep(blended, before * alpha);
      store(p.transmittance + at, choose(blended, before, behind));
      const Floats g_red = load(p.red + at), g_green = load(p.green + at), g_blue = load(p.blue + at);
      const Floats own = weight * (g_red * splat.red + g_green * splat.green + g_blue * splat.blue);
      const Floats rest = load(p.rest + at);
      store(p.rest + at, rest + own);
      sums[BY_RED] += weight * g_red;
      sums[BY_GREEN] += weight * g_green;
      sums[BY_BLUE] += weight * g_blue;
      // A clamped alpha passes nothing on.
      const Mask passes = OPAQUE ? and_not(blended, at_least(raw, all(ALPHA_MAX))) : blended;
      const Floats g = keep(passes, own - rest * (alpha * inverse)), times_d = g * d;
      by_1 += g;
      by_d += times_d;
      by_dd += times_d * d;
    }
    // u = u0 + lean d, v = v0 + across d.
    const Floats by_u = u0 * by_1 + splat.lean * by_d, by_v = v0 * by_1 + splat.across * by_d;
    const Floats by_ud = u0 * by_d + splat.lean * by_dd, by_vd = v0 * by_d + splat.across * by_dd;
    sums[SUM_1] += by_1;
    sums[SUM_U] += by_u;
    sums[SUM_V] += by_v;
    sums[SUM_UU] += u0 * by_u + splat.lean * by_ud;
    sums[SUM_UV] += v0 * by_u + splat.across * by_ud;
    sums[SUM_VV] += v0 * by_v + splat.across * by_vd;
  }
}

static void blend_backward(const FrameView &view, const SlotView &slots, const Tile &tile,
                           const FrogImageGradient &gradient) {
  constexpr float ROUNDING = 1e-6f;  // of exp2: what the forward pass clamped is clamped here
  BackwardPixels pixels;
  const uint32_t end = tile.begin + open_backward(view, tile, gradient, pixels);
  for (uint32_t n = end; n < tile.end; ++n) {
    float *out = slot_of(slots, view.instances[n]);
    __builtin_prefetch(slot_of(slots, view.instances[n + 6 < tile.end ? n + 6 : n]), 1);
    for (int i = 0; i < SPLAT_GRADIENTS; ++i) out[i] = 0;
  }
  Footprints footprints(view, tile, end - 1);
  uint32_t open[COLUMNS];
  for (uint32_t n = end; n-- > tile.begin;) {
    const uint32_t k = n - tile.begin;
    if (n == end - 1 || k % CHECK_EVERY == CHECK_EVERY - 1) gone_through(pixels.reached, k - k % CHECK_EVERY, open);
    const Instance &instance = view.instances[n], &soon = view.instances[k >= 6 ? n - 6 : n];
    float *out = slot_of(slots, instance);
    __builtin_prefetch(slot_of(slots, soon), 1);
    __builtin_prefetch(view.splats + soon.splat);
    const Splat &splat = view.splats[instance.splat];
    const Footprint &f = footprints.at(n, n - 1);
    Floats sums[SPLAT_GRADIENTS] = {};
    if (splat.log2_opacity > LOG2_ALPHA_MAX - ROUNDING)
      sum_columns<true>(splat, f, k, open, pixels, sums);
    else
      sum_columns<false>(splat, f, k, open, pixels, sums);
    sums_of_8(sums, out);
    for (int i = 8; i < SPLAT_GRADIENTS; ++i) out[i] = sum(sums[i]);
  }
}
