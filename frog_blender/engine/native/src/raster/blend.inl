// Front-to-back blending of one tile.
//
// A pixel is finished by the Gaussian that would take its transmittance below TRANSMITTANCE_MIN (that one is left out).
// A finished pixel keeps its transmittance with a minus sign, which fails every later test by itself.

static inline bool inside(const TileSize &size, int pixel) {
  return pixel % TILE < size.columns && pixel / TILE < size.rows;
}

// Pixels outside the image start finished. `limit` may be null.
static inline void open_tile(const FrameView &view, const Tile &tile, float *transmittance, float *limit) {
  const TileSize size = size_of(view, tile);
  for (int i = 0; i < TILE_PIXELS; ++i) {
    transmittance[i] = inside(size, i) ? 1.0f : -1.0f;
    if (limit) limit[i] = inside(size, i) ? view.options.depth_limit[image_index(view, tile, i)] : 0.0f;
  }
}

// What a splat does to one vector of pixels of transmittance t.
struct Contribution {
  Mask blended;
  Floats weight;  // zero where not blended
  Floats next;    // transmittance as it is stored
};

template <bool LIMIT>
static inline void contribution_of(Floats power, Floats t, float depth, const float *limit, Contribution &c) {
  const Mask touched = at_least(power, all(LOG2_ALPHA_MIN));
  // t (1 - alpha) to its last digit, for the way back divides by 1 - alpha: t - t alpha has lost digits where alpha is
  // near 1.
  const Floats alpha = smaller(exp2(power), all(ALPHA_MAX)), behind = without(t, alpha);
  c.blended = at_least(touched, behind, all(TRANSMITTANCE_MIN));
  if (LIMIT) c.blended = at_least(c.blended, load(limit), all(depth));
  c.weight = keep(c.blended, t * alpha);
  c.next = choose(c.blended, behind, negative(touched, t));
}

static inline bool still_open(const float *transmittance, uint32_t *rows) {
  return rows_where([&](int at) { return at_least(load(transmittance + at), Floats{}); }, rows);
}

// Bits of what a pass does besides colour.
enum { WITH_DEPTH = 1, WITH_WEIGHTS = 2, WITH_LIMIT = 4, WITH_BACKWARD = 8, ONLY_COUNT = 16 };

// Returns the number of blended pairs where it only counts.
template <int WITH>
static int64_t blend_tile(const FrameView &view, const Tile &tile, const FrogImage &image) {
  constexpr bool DEPTH = WITH & WITH_DEPTH, WEIGHTS = WITH & WITH_WEIGHTS, LIMIT = WITH & WITH_LIMIT;
  constexpr bool BACKWARD = WITH & WITH_BACKWARD, COUNT = WITH & ONLY_COUNT;
  struct alignas(64) {  // together: one address for all of a vector's numbers
    float transmittance[TILE_PIXELS], red[TILE_PIXELS] = {}, green[TILE_PIXELS] = {}, blue[TILE_PIXELS] = {};
    alignas(64) int32_t reached[BACKWARD ? TILE_PIXELS : 1] = {};
    alignas(64) float limit[LIMIT ? TILE_PIXELS : 1];
    alignas(64) float depth[DEPTH ? TILE_PIXELS : 1] = {};
    alignas(
        64) float covered[DEPTH ? TILE_PIXELS : 1] = {};  // 1 - transmittance, which has few digits where that is faint
    alignas(64) int32_t median[DEPTH ? TILE_PIXELS : 1];
  } p;
  open_tile(view, tile, p.transmittance, LIMIT ? p.limit : nullptr);
  if (DEPTH)
    for (int i = 0; i < TILE_PIXELS; ++i) p.median[i] = -1;
  const TileSize size = size_of(view, tile);
  uint32_t open[COLUMNS];
  still_open(p.transmittance, open);
  int64_t blended_pairs = 0;
  Footprints footprints(view, tile, tile.begin);

  for (uint32_t n = tile.begin; n < tile.end; ++n) {
    if ((n - tile.begin) % CHECK_EVERY == CHECK_EVERY - 1 && !still_open(p.transmittance, open)) break;
    __builtin_prefetch(view.splats + view.instances[n + 6 < tile.end ? n + 6 : n].splat);
    const uint32_t index = view.instances[n].splat;
    const Splat &splat = view.splats[index];
    const Footprint &f = footprints.at(n, n + 1);
    const Ints turn = all_ints(static_cast<int32_t>(n - tile.begin + 1));
    Floats heaviest = {};
    for (size_t v = 0; v < COLUMNS; ++v) {
      const Floats along = columns_of(f, v) * splat.along;
      for (uint32_t rows = f.rows[v] & open[v]; rows; rows &= rows - 1) {
        const size_t row = lowest(rows), at = row * TILE + v * LANES;
        const Floats u = along + f.shift[row], power = f.constant[row] - u * u;
        const Floats t = load(p.transmittance + at);
        Contribution c;
        contribution_of<LIMIT>(power, t, splat.depth, p.limit + (LIMIT ? at : 0), c);
        store(p.transmittance + at, c.next);
        if (COUNT) {
          blended_pairs += count(c.blended);
          continue;
        }
        if (BACKWARD) store(c.blended, p.reached + at, turn);
        store(p.red + at, load(p.red + at) + c.weight * splat.red);
        store(p.green + at, load(p.green + at) + c.weight * splat.green);
        store(p.blue + at, load(p.blue + at) + c.weight * splat.blue);
        if (DEPTH) {
          store(p.depth + at, load(p.depth + at) + c.weight * splat.depth);
          store(p.covered + at, load(p.covered + at) + c.weight);
          const Mask crossing = and_not(c.blended, at_least(c.next, all(0.50000006f)));  // the first float above 1/2
          store(p.median + at,
                choose(at_least(crossing, t, all(0.50000006f)), static_cast<int32_t>(index), load(p.median + at)));
        }
        if (WEIGHTS) heaviest = larger(c.weight, heaviest);
      }
    }
    if (WEIGHTS) view.slot_weights[view.instances[n].slot] = largest(heaviest);
  }
  if (COUNT) return blended_pairs;

  for (int row = 0; row < size.rows; ++row) {
    const int begin = row * TILE, end = begin + size.columns;
    const long long to = image_index(view, tile, begin) - begin;
    for (int i = begin; i < end; ++i) {
      const float left = fabsf(p.transmittance[i]);
      float *rgb = image.rgb + 3 * (to + i);
      rgb[0] = p.red[i] + left * view.options.background[0];
      rgb[1] = p.green[i] + left * view.options.background[1];
      rgb[2] = p.blue[i] + left * view.options.background[2];
      image.alpha[to + i] = 1 - left;
      if (BACKWARD) view.transmittance[to + i] = left, view.reached[to + i] = p.reached[i];
      if (DEPTH) {
        image.median_index[to + i] = p.median[i];
        image.mean_depth[to + i] = left < 1 ? p.depth[i] / p.covered[i] : __builtin_nanf("");
      }
    }
  }
  return 0;
}

static void blend(const FrameView &view, const Tile &tile, const FrogImage &image) {
  constexpr int64_t (*passes[16])(const FrameView &, const Tile &, const FrogImage &) = {
      blend_tile<0>,  blend_tile<1>,  blend_tile<2>,  blend_tile<3>, blend_tile<4>,  blend_tile<5>,
      blend_tile<6>,  blend_tile<7>,  blend_tile<8>,  blend_tile<9>, blend_tile<10>, blend_tile<11>,
      blend_tile<12>, blend_tile<13>, blend_tile<14>, blend_tile<15>};
  passes[(image.median_index ? WITH_DEPTH : 0) | (view.slot_weights ? WITH_WEIGHTS : 0) |
         (view.options.depth_limit ? WITH_LIMIT : 0) | (view.reached ? WITH_BACKWARD : 0)](view, tile, image);
}

static int64_t count_blended(const FrameView &view, const Tile &tile) {
  const FrogImage none = {};
  return view.options.depth_limit ? blend_tile<ONLY_COUNT | WITH_LIMIT>(view, tile, none)
                                  : blend_tile<ONLY_COUNT>(view, tile, none);
}
