// What blending and its gradient have in common: a tile's pixels in vectors, and one splat's part of it.
//
// A pixel is finished by the Gaussian that would take its transmittance below TRANSMITTANCE_MIN (that one is left out).
// A finished pixel keeps its transmittance with the sign flipped, which fails every later test by itself.

static_assert(TILE % LANES == 0, "a tile row is a whole number of vectors");
constexpr int TILE_PIXELS = TILE * TILE;

// One splat in a tile: the rows and vectors of columns that its bounding box touches, and its power row by row:
// power = constant[row] - u^2 with u = along dx + shift[row].
struct alignas(64) Footprint {
  float v[TILE], shift[TILE], constant[TILE];
  float left;  // dx of the tile's first column
  int first_row, last_row, first_vector, last_vector;
};

static inline void make_footprint(const Splat &splat, const Tile &tile, int rows, Footprint &f) {
  constexpr float MARGIN = 0.01f;  // pixels, for rounding; every pixel is tested anyway
  const float x = splat.x - (tile.x * TILE + 0.5f), y = splat.y - (tile.y * TILE + 0.5f);  // in pixel centres
  const float reach_x = splat.extent_x + MARGIN, reach_y = splat.extent_y + MARGIN;
  // Conversion truncates, which only ever adds a row or a vector.
  f.first_row = static_cast<int>(clamped(y - reach_y, 0, TILE));
  f.last_row = static_cast<int>(clamped(y + reach_y + 1, 0, static_cast<float>(rows))) - 1;
  f.first_vector = LANES == TILE ? 0 : static_cast<int>(clamped(x - reach_x, 0, TILE)) / LANES;
  f.last_vector = LANES == TILE ? 0 : static_cast<int>(clamped(x + reach_x, -1, TILE - 1) + LANES) / LANES - 1;
  f.left = -x;
  static const float ramp[TILE] = {0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15};
  for (int i = 0; i < TILE; i += LANES) {
    const Floats dy = load(ramp + i) - y;
    const Floats v = dy * splat.across;
    store(f.v + i, v);
    store(f.shift + i, dy * splat.lean);
    store(f.constant + i, splat.log2_opacity - v * v);
  }
}

static inline Floats columns_of(const Footprint &f, int vector) {  // dx
  static const float ramp[TILE] = {0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15};
  return load(ramp + vector * LANES) + f.left;
}

// What a splat does to one vector of pixels of transmittance t.
struct Contribution {
  Mask blended;
  Floats raw, alpha;  // before and after the clamp
  Floats weight;      // zero where not blended
  Floats next;        // transmittance behind it, as it is stored
};

// False when no pixel of the vector is touched.
template <bool LIMIT>
static inline bool contribution_of(Floats power, Floats t, float depth, const float *limit, Contribution &c) {
  Mask drawn = at_least(at_least(t, all(TRANSMITTANCE_MIN)), power, all(LOG2_ALPHA_MIN));
  if (!any(drawn)) return false;
  c.raw = exp2(power);
  c.alpha = smaller(c.raw, all(ALPHA_MAX));
  const Floats next = t - t * c.alpha;
  c.blended = at_least(drawn, next, all(TRANSMITTANCE_MIN));
  if (LIMIT) c.blended = at_least(c.blended, load(limit), all(depth));
  c.weight = keep(c.blended, t * c.alpha);
  c.next = negate(and_not(drawn, c.blended), choose(c.blended, next, t));
  return true;
}

static inline bool finished(const float *transmittance) {
  Floats open = all(-1.0f);
  for (int i = 0; i < TILE_PIXELS; i += LANES) open = larger(open, load(transmittance + i));
  return !any(at_least(open, Floats{}));
}

// How often a tile is looked at for being finished, in splats.
constexpr uint32_t CHECK_EVERY = 16;

struct TileSize {
  int columns, rows;
};

static inline TileSize size_of(const FrameView &view, const Tile &tile) {
  const int right = view.options.region[2] - tile.x * TILE, bottom = view.options.region[3] - tile.y * TILE;
  return {right < TILE ? right : TILE, bottom < TILE ? bottom : TILE};
}

static inline bool inside(const TileSize &size, int pixel) { return pixel % TILE < size.columns && pixel / TILE < size.rows; }

static inline long long picture_index(const FrameView &view, const Tile &tile, int pixel) {
  return static_cast<long long>(tile.y * TILE + pixel / TILE) * view.options.region[2] + tile.x * TILE + pixel % TILE;
}

// Pixels outside the picture start finished. `limit` may be null.
static inline void open_tile(const FrameView &view, const Tile &tile, float *transmittance, float *limit) {
  const TileSize size = size_of(view, tile);
  for (int i = 0; i < TILE_PIXELS; ++i) {
    transmittance[i] = inside(size, i) ? 1.0f : -1.0f;
    if (limit) limit[i] = inside(size, i) ? view.options.depth_limit[picture_index(view, tile, i)] : 0.0f;
  }
}
