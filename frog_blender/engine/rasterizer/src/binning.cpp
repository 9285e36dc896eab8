#include "binning.h"

#include <algorithm>
#include <cmath>
#include <cstring>
#include <numeric>

#include "thread_pool.h"

namespace frog {
namespace {

// Stable least-significant-digit radix sort by depth. Positive floats order like their bits; equal depths keep index order.
std::vector<uint32_t> sort_by_depth(const std::vector<Splat> &splats, std::vector<uint32_t> order) {
  constexpr int BITS = 11, BUCKETS = 1 << BITS;
  const size_t count = order.size();
  std::vector<uint32_t> keys(count), other_keys(count), other(count);
  for (size_t i = 0; i < count; ++i) std::memcpy(&keys[i], &splats[order[i]].depth, 4);
  for (int pass = 0; pass < 3; ++pass) {
    uint32_t start[BUCKETS + 1] = {};
    const int shift = pass * BITS;
    for (uint32_t key : keys) ++start[((key >> shift) & (BUCKETS - 1)) + 1];
    for (int i = 0; i < BUCKETS; ++i) start[i + 1] += start[i];
    for (size_t i = 0; i < count; ++i) {
      uint32_t to = start[(keys[i] >> shift) & (BUCKETS - 1)]++;
      other_keys[to] = keys[i];
      other[to] = order[i];
    }
    keys.swap(other_keys);
    order.swap(other);
  }
  return order;
}

// Tiles of tile row `row` that the splat's ellipse {alpha >= ALPHA_MIN} reaches: exact for the row's band of pixel centres.
Span span_of(const Splat &splat, int row, const FrameView &view) {
  constexpr float MARGIN = 0.01f;  // pixels; covers rounding, the blend tests every pixel anyway
  const float top = row * TILE + 0.5f - splat.y, bottom = top + TILE - 1;
  const float low = std::max(top, -splat.extent_y), high = std::min(bottom, splat.extent_y);
  Span span{0, -1, 0};
  if (low > high) return span;
  // Boundary: a dx^2 + 2 b dx dy + c dy^2 = cutoff, where c - b^2 / a = cutoff / extent_y^2.
  const float curvature = splat.cutoff / (splat.extent_y * splat.extent_y);
  auto half_width = [&](float dy) {
    return std::sqrt(std::max(0.0f, curvature * (splat.extent_y * splat.extent_y - dy * dy) / splat.a));
  };
  const float right_dy = std::min(std::max(splat.lean, low), high);
  const float left_dy = std::min(std::max(-splat.lean, low), high);
  const float right = splat.x - splat.b / splat.a * right_dy + half_width(right_dy) + MARGIN;
  const float left = splat.x - splat.b / splat.a * left_dy - half_width(left_dy) - MARGIN;
  const float limit = static_cast<float>(view.camera.width);
  if (!(right >= 0.5f && left <= limit)) return span;
  const int first = static_cast<int>(std::ceil(std::max(left - 0.5f, 0.0f)));
  const int last = static_cast<int>(std::floor(std::min(right - 0.5f, limit - 1)));
  if (first > last) return span;
  span.first = static_cast<int16_t>(first / TILE);
  span.last = static_cast<int16_t>(last / TILE);
  return span;
}

}  // namespace

void bin_splats(FrogFrame &frame) {
  FrameView &view = frame.view;
  const std::vector<Splat> &splats = frame.splats;
  const int count = view.count;

  std::vector<uint32_t> visible, row_begin(count + 1, 0);
  visible.reserve(count);
  for (int i = 0; i < count; ++i) {
    const bool seen = splats[i].radius > 0;
    if (seen) visible.push_back(i);
    row_begin[i + 1] = row_begin[i] + (seen ? splats[i].last_row - splats[i].first_row + 1 : 0);
  }

  std::vector<Span> spans(row_begin[count]);
  frame.slot_begin.assign(count + 1, 0);
  parallel_for(count, 1024, [&](int begin, int end) {
    for (int i = begin; i < end; ++i) {
      uint32_t slots = 0;
      for (uint32_t s = row_begin[i]; s < row_begin[i + 1]; ++s) {
        spans[s] = span_of(splats[i], splats[i].first_row + static_cast<int>(s - row_begin[i]), view);
        spans[s].slot = slots;
        slots += spans[s].last - spans[s].first + 1;
      }
      frame.slot_begin[i + 1] = slots;
    }
  });
  std::partial_sum(frame.slot_begin.begin(), frame.slot_begin.end(), frame.slot_begin.begin());

  const std::vector<uint32_t> order = sort_by_depth(splats, std::move(visible));
  struct Rows { int16_t first, last; };
  std::vector<Rows> rows(order.size());  // read once for every tile row: keep it small
  for (size_t k = 0; k < order.size(); ++k) rows[k] = {splats[order[k]].first_row, splats[order[k]].last_row};

  std::vector<uint32_t> tile_begin(static_cast<size_t>(view.tiles_x) * view.tiles_y + 1, 0);
  auto each_span = [&](int row, auto &&use) {
    for (size_t k = 0; k < order.size(); ++k)
      if (rows[k].first <= row && row <= rows[k].last)
        use(order[k], spans[row_begin[order[k]] + (row - rows[k].first)]);
  };
  parallel_for(view.tiles_y, 1, [&](int begin, int end) {
    for (int row = begin; row < end; ++row)
      each_span(row, [&](uint32_t, const Span &span) {
        for (int x = span.first; x <= span.last; ++x) ++tile_begin[row * view.tiles_x + x + 1];
      });
  });
  std::partial_sum(tile_begin.begin(), tile_begin.end(), tile_begin.begin());

  frame.tile_splats.resize(tile_begin.back());
  frame.tile_slots.resize(tile_begin.back());
  parallel_for(view.tiles_y, 1, [&](int begin, int end) {
    for (int row = begin; row < end; ++row) {
      std::vector<uint32_t> next(tile_begin.begin() + row * view.tiles_x, tile_begin.begin() + (row + 1) * view.tiles_x);
      each_span(row, [&](uint32_t index, const Span &span) {
        for (int x = span.first; x <= span.last; ++x) {
          frame.tile_splats[next[x]] = index;
          frame.tile_slots[next[x]++] = frame.slot_begin[index] + span.slot + (x - span.first);
        }
      });
    }
  });

  frame.tiles.clear();
  for (int y = 0; y < view.tiles_y; ++y)
    for (int x = 0; x < view.tiles_x; ++x) {
      const size_t t = static_cast<size_t>(y) * view.tiles_x + x;
      frame.tiles.push_back({x, y, tile_begin[t], tile_begin[t + 1]});
    }
  // Dearest first, so that no thread is left alone with a crowded tile at the end.
  std::stable_sort(frame.tiles.begin(), frame.tiles.end(),
                   [](const Tile &p, const Tile &q) { return p.end - p.begin > q.end - q.begin; });
  view.tile_splats = frame.tile_splats.data();
  view.tile_slots = frame.tile_slots.data();
  view.slot_begin = frame.slot_begin.data();
}

}  // namespace frog
