// Front-to-back blending of one tile.

static inline void raise_to(float *target, float value) {  // atomic maximum of non-negative floats: any order, same result
  int32_t old = __atomic_load_n(reinterpret_cast<int32_t *>(target), __ATOMIC_RELAXED), wanted;
  __builtin_memcpy(&wanted, &value, 4);
  while (old < wanted && !__atomic_compare_exchange_n(reinterpret_cast<int32_t *>(target), &old, wanted, true,
                                                      __ATOMIC_RELAXED, __ATOMIC_RELAXED)) {
  }
}

// Bits of what a pass does besides colour.
enum { WITH_DEPTH = 1, WITH_WEIGHTS = 2, WITH_LIMIT = 4, ONLY_COUNT = 8 };

// Returns the number of blended pairs where it only counts.
template <int WITH>
static int64_t blend_tile(const FrameView &view, const Tile &tile, const FrogImage &image) {
  constexpr bool DEPTH = WITH & WITH_DEPTH, WEIGHTS = WITH & WITH_WEIGHTS, LIMIT = WITH & WITH_LIMIT, COUNT = WITH & ONLY_COUNT;
  alignas(64) float transmittance[TILE_PIXELS], red[TILE_PIXELS] = {}, green[TILE_PIXELS] = {}, blue[TILE_PIXELS] = {};
  alignas(64) float limit[LIMIT ? TILE_PIXELS : 1];
  alignas(64) float depth[DEPTH ? TILE_PIXELS : 1] = {};
  alignas(64) int32_t median[DEPTH ? TILE_PIXELS : 1];
  open_tile(view, tile, transmittance, LIMIT ? limit : nullptr);
  if (DEPTH) for (int i = 0; i < TILE_PIXELS; ++i) median[i] = -1;
  const TileSize size = size_of(view, tile);
  int64_t blended_pairs = 0;
  Footprint f;

  for (uint32_t n = tile.begin; n < tile.end; ++n) {
    if ((n - tile.begin) % CHECK_EVERY == CHECK_EVERY - 1 && finished(transmittance)) break;
    __builtin_prefetch(view.splats + view.instances[n + 6 < tile.end ? n + 6 : n].splat);
    const uint32_t index = view.instances[n].splat;
    const Splat &splat = view.splats[index];
    make_footprint(splat, tile, size.rows, f);
    Floats heaviest = {};
    for (int v = f.first_vector; v <= f.last_vector; ++v) {
      const Floats along = columns_of(f, v) * splat.along;
      for (int row = f.first_row; row <= f.last_row; ++row) {
        const Floats u = along + f.shift[row], power = f.constant[row] - u * u;
        const int at = row * TILE + v * LANES;
        const Floats t = load(transmittance + at);
        Contribution c;
        if (!contribution_of<LIMIT>(power, t, splat.depth, limit + (LIMIT ? at : 0), c)) continue;
        store(transmittance + at, c.next);
        if (COUNT) {
          blended_pairs += count(c.blended);
          continue;
        }
        store(red + at, load(red + at) + c.weight * splat.red);
        store(green + at, load(green + at) + c.weight * splat.green);
        store(blue + at, load(blue + at) + c.weight * splat.blue);
        if (DEPTH) {
          store(depth + at, load(depth + at) + c.weight * splat.depth);
          const Mask crossing = and_not(c.blended, at_least(c.next, all(0.50000006f)));  // the first float above 1/2
          store(median + at, choose(at_least(crossing, t, all(0.50000006f)), static_cast<int32_t>(index), load(median + at)));
        }
        if (WEIGHTS) heaviest = larger(c.weight, heaviest);
      }
    }
    if (WEIGHTS) {
      const float weight = largest(heaviest);
      if (weight > 0) raise_to(image.max_weights + index, weight);
    }
  }
  if (COUNT) return blended_pairs;

  for (int from = 0; from < TILE_PIXELS; ++from) {
    if (!inside(size, from)) continue;
    const long long to = picture_index(view, tile, from);
    const float left = fabsf(transmittance[from]);
    image.rgb[3 * to] = red[from] + left * view.options.background[0];
    image.rgb[3 * to + 1] = green[from] + left * view.options.background[1];
    image.rgb[3 * to + 2] = blue[from] + left * view.options.background[2];
    image.alpha[to] = 1 - left;
    if (DEPTH) {
      image.median_index[to] = median[from];
      image.mean_depth[to] = left < 1 ? depth[from] / (1 - left) : __builtin_nanf("");
    }
  }
  return 0;
}

static void blend(const FrameView &view, const Tile &tile, const FrogImage &image) {
  constexpr int64_t (*passes[8])(const FrameView &, const Tile &, const FrogImage &) = {
      blend_tile<0>, blend_tile<1>, blend_tile<2>, blend_tile<3>, blend_tile<4>, blend_tile<5>, blend_tile<6>, blend_tile<7>};
  passes[(image.median_index ? WITH_DEPTH : 0) | (image.max_weights ? WITH_WEIGHTS : 0) |
         (view.options.depth_limit ? WITH_LIMIT : 0)](view, tile, image);
}

static int64_t count_blended(const FrameView &view, const Tile &tile) {
  const FrogImage none = {};
  return view.options.depth_limit ? blend_tile<ONLY_COUNT | WITH_LIMIT>(view, tile, none) : blend_tile<ONLY_COUNT>(view, tile, none);
}
