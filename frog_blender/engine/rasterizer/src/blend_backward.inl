// Gradients of one tile, by the same walk front to back.
//
// Picture C = sum w_i c_i + T_end background, alpha A = 1 - T_end. With g = dL/dC and h = dL/dA, the part of the loss
// that lies behind Gaussian i is rest_i = sum_{j > i} w_j g.c_j + T_end (g.background - h); it starts as
// g.C - h T_end and loses w_i g.c_i at each step. Then dL/dalpha_i = T_i g.c_i - rest_i / (1 - alpha_i), and
// dL/dlog(alpha_i) = w_i g.c_i - rest_i alpha_i / (1 - alpha_i).

static inline float *slot_of(const SlotView &slots, const Instance &instance) {
  // The sum wraps on purpose, see place_slots.
  return slots.gradients + static_cast<size_t>(slots.slot_base[instance.splat] + instance.slot) * slots.width;
}

template <bool LIMIT, bool ABSOLUTE>
static void blend_tile_backward(const FrameView &view, const SlotView &slots, const Tile &tile, const FrogImage &image,
                                const FrogImageGradient &gradient) {
  alignas(64) float transmittance[TILE_PIXELS], rest[TILE_PIXELS] = {}, limit[LIMIT ? TILE_PIXELS : 1];
  alignas(64) float red[TILE_PIXELS] = {}, green[TILE_PIXELS] = {}, blue[TILE_PIXELS] = {};  // dL/dC
  open_tile(view, tile, transmittance, LIMIT ? limit : nullptr);
  const TileSize size = size_of(view, tile);
  for (int row = 0; row < size.rows; ++row) {
    long long at = picture_index(view, tile, row * TILE);
    for (int i = row * TILE; i < row * TILE + size.columns; ++i, ++at) {
      red[i] = gradient.rgb[3 * at], green[i] = gradient.rgb[3 * at + 1], blue[i] = gradient.rgb[3 * at + 2];
      rest[i] = red[i] * image.rgb[3 * at] + green[i] * image.rgb[3 * at + 1] + blue[i] * image.rgb[3 * at + 2];
      if (gradient.alpha) rest[i] -= gradient.alpha[at] * (1 - image.alpha[at]);
    }
  }
  Footprint f;
  bool over = false;

  for (uint32_t n = tile.begin; n < tile.end; ++n) {
    const Instance &instance = view.instances[n], &soon = view.instances[n + 6 < tile.end ? n + 6 : n];
    float *out = slot_of(slots, instance);
    __builtin_prefetch(slot_of(slots, soon), 1);
    over = over || ((n - tile.begin) % CHECK_EVERY == CHECK_EVERY - 1 && finished(transmittance));
    if (over) {
      for (int k = 0; k < slots.width; ++k) out[k] = 0;
      continue;
    }
    __builtin_prefetch(view.splats + soon.splat);
    const Splat &splat = view.splats[instance.splat];
    make_footprint(splat, tile, size.rows, f);
    // The order of SplatGradient.
    Floats sums[SPLAT_GRADIENTS] = {};
    for (int v = f.first_vector; v <= f.last_vector; ++v) {
      const Floats along = columns_of(f, v) * splat.along;
      for (int row = f.first_row; row <= f.last_row; ++row) {
        const Floats u = along + f.shift[row], power = f.constant[row] - u * u;
        const int at = row * TILE + v * LANES;
        const Floats t = load(transmittance + at);
        Contribution c;
        if (!contribution_of<LIMIT>(power, t, splat.depth, limit + (LIMIT ? at : 0), c)) continue;
        store(transmittance + at, c.next);
        const Floats g_red = load(red + at), g_green = load(green + at), g_blue = load(blue + at);
        const Floats own = c.weight * (g_red * splat.red + g_green * splat.green + g_blue * splat.blue);
        const Floats behind = load(rest + at) - own;
        store(rest + at, behind);
        sums[BY_RED] += c.weight * g_red;
        sums[BY_GREEN] += c.weight * g_green;
        sums[BY_BLUE] += c.weight * g_blue;
        // A clamped alpha passes nothing on.
        const Mask passes = and_not(c.blended, at_least(c.raw, all(ALPHA_MAX)));
        const Floats by_log_alpha = keep(passes, own - behind * (c.alpha * reciprocal(1.0f - c.alpha)));
        const Floats by_u = by_log_alpha * u, by_v = by_log_alpha * f.v[row];
        sums[SUM_1] += by_log_alpha;
        sums[SUM_U] += by_u;
        sums[SUM_V] += by_v;
        sums[SUM_UU] += by_u * u;
        sums[SUM_UV] += by_u * f.v[row];
        sums[SUM_VV] += by_v * f.v[row];
        if (ABSOLUTE) {  // d(log alpha)/d(position)
          sums[ABSOLUTE_X] += absolute(by_u * (2 / LOG2E * splat.along));
          sums[ABSOLUTE_Y] += absolute((by_u * splat.lean + by_v * splat.across) * (2 / LOG2E));
        }
      }
    }
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
