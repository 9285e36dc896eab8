// The deformation network's forward pass for playback: four Gaussians at a time, so that each weight loaded serves four.

static inline void dense(const FrogLayer &layer, float *const *rows) {
  constexpr int GROUP = 16 / LANES > 1 ? 2 : 1;  // vectors of outputs at a time
  for (int o = 0; o < layer.outputs; o += GROUP * LANES) {
    Floats sums[4][GROUP];
    for (int r = 0; r < 4; ++r)
      for (int v = 0; v < GROUP; ++v) sums[r][v] = load(layer.bias + o + v * LANES);
    for (int i = 0; i < layer.inputs; ++i)
      for (int v = 0; v < GROUP; ++v) {
        const Floats weight = load(layer.weights + static_cast<long>(i) * layer.outputs + o + v * LANES);
        for (int r = 0; r < 4; ++r) sums[r][v] += weight * rows[r][layer.input + i];
      }
    for (int r = 0; r < 4; ++r)
      for (int v = 0; v < GROUP; ++v)
        store(rows[r] + layer.output + o + v * LANES, layer.relu ? (sums[r][v] > 0.0f ? sums[r][v] : Floats{}) : sums[r][v]);
  }
}

static void network(int begin, int end, int hidden, const float *first, const float *shared, int layer_count,
                    const FrogLayer *layers, int row_length, int outputs, float *scratch, float *result) {
  for (int i = begin; i < end; i += 4) {
    float *rows[4];
    for (int r = 0; r < 4; ++r) {
      rows[r] = scratch + static_cast<long>(r) * row_length;
      const float *from = first + static_cast<long>(i + r < end ? i + r : end - 1) * hidden;
      for (int k = 0; k < hidden; ++k) rows[r][k] = from[k] + shared[k] > 0 ? from[k] + shared[k] : 0;
    }
    for (int l = 0; l < layer_count; ++l) dense(layers[l], rows);
    for (int r = 0; r < 4 && i + r < end; ++r)
      for (int k = 0; k < outputs; ++k)
        result[static_cast<long>(i + r) * outputs + k] = rows[r][row_length - outputs + k];
  }
}
