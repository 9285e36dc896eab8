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

// Adds what the pixels send back, in the order of SplatGradient. In a column u and v depend on the row alone, so three
// sums over its rows, of g = dL/dlog(alpha), g d and g d^2, give all five moments. d counts from where the column comes
// nearest to the splat's axis u = 0: counted from anywhere else, a slanting needle's sums would cancel.
template <bool LIMIT, bool ABSOLUTE, bool OPAQUE>
static inline void sum_columns(const Splat &splat, const Footprint &f, const uint32_t *open, BackwardPixels<LIMIT> &p, Floats *sums) {
  const float over_lean = -1 / splat.lean;
  for (size_t c = 0; c < COLUMNS; ++c) {
    const Floats along = columns_of(f, c) * splat.along, start = along + f.shift[0];
    const Floats nearest = larger(smaller(start * over_lean, all(TILE - 1)), Floats{});  // a row; finite whatever lean is
    const Floats u0 = start + splat.lean * nearest, v0 = f.v[0] + splat.across * nearest;
    Floats by_1 = {}, by_d = {}, by_dd = {};
    for (uint32_t rows = f.rows[c] & open[c]; rows; rows &= rows - 1) {
      const size_t row = lowest(rows), at = row * TILE + c * LANES;
      const Floats d = ramp[row] - nearest;
      const Floats u = along + f.shift[row], power = f.constant[row] - u * u;
      const Floats t = load(p.transmittance + at);
      Contribution part;
      contribution_of<LIMIT, OPAQUE>(power, t, splat.depth, p.limit + (LIMIT ? at : 0), part);
      store(p.transmittance + at, part.next);
      const Floats g_red = load(p.red + at), g_green = load(p.green + at), g_blue = load(p.blue + at);
      const Floats own = part.weight * (g_red * splat.red + g_green * splat.green + g_blue * splat.blue);
      const Floats behind = load(p.rest + at) - own;
      store(p.rest + at, behind);
      sums[BY_RED] += part.weight * g_red;
      sums[BY_GREEN] += part.weight * g_green;
      sums[BY_BLUE] += part.weight * g_blue;
      // alpha / (1 - alpha) = weight / transmittance behind. A clamped alpha passes nothing on.
      const Mask passes = OPAQUE ? and_not(part.blended, at_least(part.raw, all(ALPHA_MAX))) : part.blended;
      const Floats g = keep(passes, own - behind * (part.weight / part.behind)), times_d = g * d;
      by_1 += g;
      by_d += times_d;
      by_dd += times_d * d;
      if (ABSOLUTE) {  // d(log alpha)/d(position)
        const Floats by_u = g * u;
        sums[ABSOLUTE_X] += absolute(by_u * (2 / LOG2E * splat.along));
        sums[ABSOLUTE_Y] += absolute((by_u * splat.lean + g * f.v[row] * splat.across) * (2 / LOG2E));
      }
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
    Floats sums[SPLAT_GRADIENTS] = {};
    if (is_opaque(splat)) sum_columns<LIMIT, ABSOLUTE, true>(splat, f, open, pixels, sums);
    else sum_columns<LIMIT, ABSOLUTE, false>(splat, f, open, pixels, sums);
    sums_of_8(sums, out);
    for (int k = 8; k < (ABSOLUTE ? SPLAT_GRADIENTS : BY_BLUE + 1); ++k) out[k] = sum(sums[k]);
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
