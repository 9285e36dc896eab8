// What blending and its gradient have in common: a tile's pixels in vectors, and where a splat touches them.

static_assert(TILE % LANES == 0, "a tile row is a whole number of vectors");
constexpr int TILE_PIXELS = TILE * TILE;

constexpr int COLUMNS = TILE / LANES;  // of vectors

static const float ramp[TILE] = {0, 1, 2,  3,  4,  5,  6,  7,
                                 8, 9, 10, 11, 12, 13, 14, 15};  // of rows, or columns of pixels

static inline size_t lowest(uint32_t rows) { return static_cast<uint32_t>(__builtin_ctz(rows)); }

// One splat in a tile: which rows of each column of vectors it touches, and its power row by row:
// power = constant[row] - u^2 with u = along dx + shift[row].
struct alignas(64) Footprint {
  float v[TILE], shift[TILE], constant[TILE];
  float left;              // dx of the tile's first column
  uint32_t rows[COLUMNS];  // a bit for each row
};

// Tells the rows before any pixel is looked at: a branch for each of them, at an ellipse's rim, would be guessed wrong.
static inline void make_footprint(const Splat &splat, const Tile &tile, Footprint &f) {
  constexpr float MARGIN = 0.02f;  // of a power, for rounding; every pixel is tested anyway
  const float x = splat.x - (tile.x * TILE + 0.5f), y = splat.y - (tile.y * TILE + 0.5f);  // in pixel centres
  f.left = -x;
  for (int c = 0; c < COLUMNS; ++c) f.rows[c] = 0;
  for (int i = 0; i < TILE; i += LANES) {
    const Floats dy = load(ramp + i) - y;
    const Floats v = dy * splat.across, shift = dy * splat.lean, constant = splat.log2_opacity - v * v;
    store(f.v + i, v);
    store(f.shift + i, shift);
    store(f.constant + i, constant);
    for (int c = 0; c < COLUMNS; ++c) {
      const Floats first = shift + splat.along * (c * LANES - x), last = first + splat.along * (LANES - 1);
      const Floats nearest = larger(larger(first, -last), Floats{});  // |u| of the column's nearest place
      f.rows[c] |= bits(at_least(constant - nearest * nearest, all(LOG2_ALPHA_MIN - MARGIN))) << i;
    }
  }
}

// The footprints of a tile's splats, one after the other. Each is found while the pixels of the one before are worked
// on, so that which rows come next is known long before their turn.
struct Footprints {
  const FrameView &view;
  const Tile &tile;
  Footprint pair[2];

  Footprints(const FrameView &view, const Tile &tile, uint32_t first) : view(view), tile(tile) { find(first); }
  void find(uint32_t n) {  // nothing beyond either end
    if (n - tile.begin < tile.end - tile.begin) make_footprint(view.splats[view.instances[n].splat], tile, pair[n & 1]);
  }
  const Footprint &at(uint32_t n, uint32_t next) {  // `next` is a neighbour of n
    find(next);
    return pair[n & 1];
  }
};

static inline Floats columns_of(const Footprint &f, int vector) {  // dx
  return load(ramp + vector * LANES) + f.left;
}

// Rows of each column of vectors in which a pixel passes `test`, which takes a vector's place; false when there is
// none.
template <class Test>
static inline bool rows_where(Test test, uint32_t *rows) {
  uint32_t anywhere = 0;
  for (int c = 0; c < COLUMNS; ++c) {
    rows[c] = 0;
    for (int row = 0; row < TILE; ++row) rows[c] |= static_cast<uint32_t>(any(test(row * TILE + c * LANES))) << row;
    anywhere |= rows[c];
  }
  return anywhere;
}

// How often it is prefetcher which of a tile's pixels still take part, in splats.
constexpr uint32_t CHECK_EVERY = 16;

struct TileSize {
  int columns, rows;
};

static inline TileSize size_of(const FrameView &view, const Tile &tile) {
  const int right = view.options.region[2] - tile.x * TILE, bottom = view.options.region[3] - tile.y * TILE;
  return {right < TILE ? right : TILE, bottom < TILE ? bottom : TILE};
}

static inline long long image_index(const FrameView &view, const Tile &tile, int pixel) {
  return static_cast<long long>(tile.y * TILE + pixel / TILE) * view.options.region[2] + tile.x * TILE + pixel % TILE;
}
