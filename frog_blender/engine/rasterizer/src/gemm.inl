// Small dense matrix products, C (+)= A B, for matrices that lie in the processor's caches.
//
// A is read one number at a time through two strides, so that it may be a transpose; rows of B and C are contiguous and
// their lengths whole vectors (callers pad).

struct MatrixView {
  const float *data;
  long long row, column;  // strides
};

template <int ROWS, int VECTORS, bool ADD>
static inline void multiply_block(int inner, const MatrixView &a, const float *b, long long b_row, float *c, long long c_row) {
  Floats sums[ROWS][VECTORS];
  for (int r = 0; r < ROWS; ++r)
    for (int v = 0; v < VECTORS; ++v) sums[r][v] = ADD ? load(c + r * c_row + v * LANES) : Floats{};
  for (int k = 0; k < inner; ++k) {
    Floats row[VECTORS];
    for (int v = 0; v < VECTORS; ++v) row[v] = load(b + k * b_row + v * LANES);
    for (int r = 0; r < ROWS; ++r) {
      const float factor = a.data[r * a.row + k * a.column];
      for (int v = 0; v < VECTORS; ++v) sums[r][v] += row[v] * factor;
    }
  }
  for (int r = 0; r < ROWS; ++r)
    for (int v = 0; v < VECTORS; ++v) store(c + r * c_row + v * LANES, sums[r][v]);
}

template <int VECTORS, bool ADD>
static inline void multiply_columns(int rows, int inner, const MatrixView &a, const float *b, long long b_row, float *c, long long c_row) {
  // As many sums as registers hold them: 24 of 32 in AVX-512 and 12 of 16 elsewhere.
  constexpr int ROWS = 6;
  int r = 0;
  for (; r + ROWS <= rows; r += ROWS)
    multiply_block<ROWS, VECTORS, ADD>(inner, {a.data + r * a.row, a.row, a.column}, b, b_row, c + r * c_row, c_row);
  for (; r + 2 <= rows; r += 2)
    multiply_block<2, VECTORS, ADD>(inner, {a.data + r * a.row, a.row, a.column}, b, b_row, c + r * c_row, c_row);
  for (; r < rows; ++r)
    multiply_block<1, VECTORS, ADD>(inner, {a.data + r * a.row, a.row, a.column}, b, b_row, c + r * c_row, c_row);
}

// C (rows, columns) = or += A (rows, inner) B (inner, columns).
template <bool ADD>
static void multiply(int rows, int inner, int columns, const MatrixView &a, const float *b, long long b_row, float *c, long long c_row) {
  constexpr int VECTORS = LANES == TILE ? 4 : 2;
  int at = 0;
  for (; at + VECTORS * LANES <= columns; at += VECTORS * LANES)
    multiply_columns<VECTORS, ADD>(rows, inner, a, b + at, b_row, c + at, c_row);
  for (; at < columns; at += LANES) multiply_columns<1, ADD>(rows, inner, a, b + at, b_row, c + at, c_row);
}
