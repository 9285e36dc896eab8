// Adds the gradient of the weighted distances between neighbours' embeddings, see NeighbourGraph.add_gradient: a warp
// for each entry of the anchors and, after them, the neighbours. The first entry that names a row adds up what all of
// them bring, in their order: no atomics, the same bits in every run.
#include "common.cuh"

// Embeddings are rows of `row` numbers, of which the first `width` are compared; each of `count` anchors has `near`
// neighbours.
extern "C" __global__ void __launch_bounds__(THREADS)
    smooth(int count, int near, int width, int row, const float *embeddings, const long long *anchors,
           const long long *neighbours, const float *weights, float scale, float *gradient) {
  const int entries = count * (1 + near), own = static_cast<int>(blockIdx.x) * WARPS + warp_index();
  if (own >= entries) return;
  const auto named = [&](int entry) { return entry < count ? anchors[entry] : neighbours[entry - count]; };
  const long long target = named(own);
  for (int first = 0; first < width; first += WARP) {
    const int column = first + lane_index();
    const auto pull = [&](int pair) {  // of a pair's neighbour on its anchor, in this lane's column
      const float *one = embeddings + anchors[pair / near] * row, *other = embeddings + neighbours[pair] * row;
      float square = 0;
      for (int k = lane_index(); k < width; k += WARP) square += (one[k] - other[k]) * (one[k] - other[k]);
      for (int offset = WARP / 2; offset; offset /= 2) square += __shfl_xor_sync(FULL, square, offset);
      return column < width ? (one[column] - other[column]) * (scale * weights[pair] / sqrtf(square + 1e-12f)) : 0;
    };
    float sum = 0;
    for (int start = 0; start < entries; start += WARP) {
      const int entry = start + lane_index();
      for (unsigned same = __ballot_sync(FULL, entry < entries && named(entry) == target); same; same &= same - 1) {
        const int one = start + __ffs(same) - 1;
        if (one < own) return;
        if (one < count)
          for (int k = 0; k < near; ++k) sum += pull(one * near + k);
        else
          sum -= pull(one - count);
      }
    }
    if (column < width) gradient[target * row + column] += sum;
  }
}
