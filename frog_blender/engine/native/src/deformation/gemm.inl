// Small dense matrix products, C (+)= A B, for matrices that lie in the processor's caches.
//
// A is read one number at a time through two strides, so that it may be a transpose; rows of B and C are contiguous
// within panels of DEFORM_PAD columns, and their lengths whole vectors (callers pad).

struct MatrixView {
  const float *data;
  long long row, column;  // strides
};

// From a row on.
static inline MatrixView rows_of(const MatrixView &a, long long first) {
  return {a.data + first * a.row, a.row, a.column};
}

// Columns in panels, each of which may lie elsewhere. A packed matrix has one panel after the other: rows of many
// columns are so far apart that a product's few columns of each would displace one another from the cache.
struct PanelView {
  const float *data;
  long long row, panel;  // strides

  const float *at(int column) const { return data + column / DEFORM_PAD * panel + column % DEFORM_PAD; }
};

static inline PanelView packed(const float *data, int inner) {
  return {data, DEFORM_PAD, static_cast<long long>(inner) * DEFORM_PAD};
}
static inline PanelView plain(const float *data, long long row) { return {data, row, DEFORM_PAD}; }

// What a product adds to: nothing, what C holds, or one row that stands for all.
enum Start { ZERO, SUM, ROW };

// `step` is from one vector of a row of B to the next; `row` is where the columns' start lies, for ROW.
template <int ROWS, int VECTORS, Start START, bool RELU, class Prefetch>
static inline void multiply_block(int inner, const MatrixView &a, const float *b, long long b_row, long long step,
                                  const float *row, float *c, long long c_row, Prefetch &prefetcher) {
  Floats sums[ROWS][VECTORS];
  for (int r = 0; r < ROWS; ++r)
    for (int v = 0; v < VECTORS; ++v)
      sums[r][v] = START == ZERO ? Floats{} : load(START == SUM ? c + r * c_row + v * LANES : row + v * LANES);
  for (int k = 0; k < inner; ++k) {
    prefetcher.next();
    Floats factors[VECTORS];
    for (int v = 0; v < VECTORS; ++v) factors[v] = load(b + k * b_row + v * step);
    for (int r = 0; r < ROWS; ++r) {
      const float factor = a.data[r * a.row + k * a.column];
      for (int v = 0; v < VECTORS; ++v) sums[r][v] += factors[v] * factor;
    }
  }
  for (int r = 0; r < ROWS; ++r)
    for (int v = 0; v < VECTORS; ++v)
      store(c + r * c_row + v * LANES, RELU ? larger(sums[r][v], Floats{}) : sums[r][v]);
}

template <int VECTORS, Start START, bool RELU, class Prefetch>
static inline void multiply_columns(int rows, int inner, const MatrixView &a, const float *b, long long b_row,
                                    long long step, const float *row, float *c, long long c_row, Prefetch &prefetcher) {
  // As many sums as registers hold them: 24 of 32 in AVX-512 and 12 of 16 elsewhere.
  constexpr int ROWS = VECTORS == 1 ? 12 : 6;
  int r = 0;
  for (; r + ROWS <= rows; r += ROWS)
    multiply_block<ROWS, VECTORS, START, RELU>(inner, rows_of(a, r), b, b_row, step, row, c + r * c_row, c_row,
                                               prefetcher);
  for (; r + 2 <= rows; r += 2)
    multiply_block<2, VECTORS, START, RELU>(inner, rows_of(a, r), b, b_row, step, row, c + r * c_row, c_row,
                                            prefetcher);
  for (; r < rows; ++r)
    multiply_block<1, VECTORS, START, RELU>(inner, rows_of(a, r), b, b_row, step, row, c + r * c_row, c_row,
                                            prefetcher);
}

// C (rows, columns) = START + A (rows, inner) B (inner, columns), negative numbers made zero with RELU; meanwhile
// memory is prefetcher for what comes later.
template <Start START, bool RELU = false, class Prefetch>
static void multiply(int rows, int inner, int columns, const MatrixView &a, const PanelView &b, float *c,
                     long long c_row, const float *row, Prefetch &prefetcher) {
  constexpr int VECTORS = LANES == TILE ? 4 : 2;
  const long long step = LANES == DEFORM_PAD ? b.panel : LANES;
  auto start = [row](int at) { return START == ROW ? row + at : nullptr; };
  int at = 0;
  for (; at + VECTORS * LANES <= columns; at += VECTORS * LANES)
    multiply_columns<VECTORS, START, RELU>(rows, inner, a, b.at(at), b.row, step, start(at), c + at, c_row, prefetcher);
  for (; at < columns; at += LANES)
    multiply_columns<1, START, RELU>(rows, inner, a, b.at(at), b.row, step, start(at), c + at, c_row, prefetcher);
}

template <Start START, bool RELU = false>
static void multiply(int rows, int inner, int columns, const MatrixView &a, const PanelView &b, float *c,
                     long long c_row, const float *row = nullptr) {
  NoPrefetch nothing;
  multiply<START, RELU>(rows, inner, columns, a, b, c, c_row, row, nothing);
}
