#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <limits>
#include <vector>

#include "api.h"
#include "threads/thread_pool.h"

namespace frog {
namespace {

constexpr int BAND = 16;  // rows that a thread draws at a time

using Point = std::array<double, 3>;  // camera space: the last along the view

// A triangle on the image: inverse depth is linear there, 1/z = a x + b y + c, and so are the three edge functions,
// which are not negative inside.
struct Flat {
  double edges[3][3], inverse[3];
  int top, bottom, left, right;  // pixels whose centres may lie inside, the last ones not included
};

int first_pixel(double edge, int begin, int size) {  // the first whose centre is at or beyond `edge`
  return static_cast<int>(std::clamp(std::ceil(edge - 0.5) - begin, 0.0, static_cast<double>(size)));
}

// Adds a triangle in front of the near plane.
void flatten(const Point corners[3], const FrogCamera &camera, const int32_t region[4], std::vector<Flat> &flats) {
  double x[3], y[3], w[3];
  for (int i = 0; i < 3; ++i) {
    w[i] = 1 / corners[i][2];
    x[i] = camera.fx * corners[i][0] * w[i] + camera.cx;
    y[i] = camera.fy * corners[i][1] * w[i] + camera.cy;
  }
  const double area = (x[1] - x[0]) * (y[2] - y[0]) - (x[2] - x[0]) * (y[1] - y[0]);
  if (!(std::abs(area) > 1e-12) || !std::isfinite(area)) return;  // seen from its edge
  Flat flat;
  for (int i = 0; i < 3; ++i) flat.inverse[i] = 0;
  for (int i = 0; i < 3; ++i) {  // the edge opposite to corner i, 1 there and 0 on the edge
    const int j = (i + 1) % 3, k = (i + 2) % 3;
    flat.edges[i][0] = (y[j] - y[k]) / area;
    flat.edges[i][1] = (x[k] - x[j]) / area;
    flat.edges[i][2] = (x[j] * y[k] - x[k] * y[j]) / area;
    for (int c = 0; c < 3; ++c) flat.inverse[c] += w[i] * flat.edges[i][c];
  }
  flat.left = first_pixel(std::min({x[0], x[1], x[2]}), region[0], region[2]);
  flat.right = first_pixel(std::max({x[0], x[1], x[2]}), region[0], region[2]);
  flat.top = first_pixel(std::min({y[0], y[1], y[2]}), region[1], region[3]);
  flat.bottom = first_pixel(std::max({y[0], y[1], y[2]}), region[1], region[3]);
  if (flat.left < flat.right && flat.top < flat.bottom) flats.push_back(flat);
}

// The part of a triangle beyond the near plane: none, one or two triangles.
void clip(const Point corners[3], double near_plane, const FrogCamera &camera, const int32_t region[4],
          std::vector<Flat> &flats) {
  Point kept[4];
  int count = 0;
  for (int i = 0; i < 3; ++i) {
    const Point &a = corners[i], &b = corners[(i + 1) % 3];
    const bool a_seen = a[2] >= near_plane, b_seen = b[2] >= near_plane;
    if (a_seen) kept[count++] = a;
    if (a_seen != b_seen) {
      const double t = (near_plane - a[2]) / (b[2] - a[2]);
      kept[count++] = {a[0] + t * (b[0] - a[0]), a[1] + t * (b[1] - a[1]), near_plane};
    }
  }
  for (int i = 2; i < count; ++i) {
    const Point fan[3] = {kept[0], kept[i - 1], kept[i]};
    flatten(fan, camera, region, flats);
  }
}

// Numbers of the triangles that reach into each band of rows: those of band b are [begin[b], begin[b + 1]) of `flats`.
struct Bands {
  std::vector<uint32_t> begin, flats;
};

Bands sort_into_bands(const std::vector<Flat> &flats, int count) {
  Bands bands;
  bands.begin.assign(count + 2, 0);
  for (const Flat &flat : flats)
    for (int b = flat.top / BAND; b <= (flat.bottom - 1) / BAND; ++b) ++bands.begin[b + 2];
  for (int b = 2; b < count + 2; ++b) bands.begin[b] += bands.begin[b - 1];
  bands.flats.resize(bands.begin.back());
  for (uint32_t i = 0; i < flats.size(); ++i)
    for (int b = flats[i].top / BAND; b <= (flats[i].bottom - 1) / BAND; ++b) bands.flats[bands.begin[b + 1]++] = i;
  return bands;
}

void draw_band(const std::vector<Flat> &flats, const Bands &bands, int band, const int32_t region[4], float *depth) {
  const int begin = band * BAND, end = std::min(begin + BAND, static_cast<int>(region[3]));
  const int width = region[2];
  std::fill(depth + static_cast<size_t>(begin) * width, depth + static_cast<size_t>(end) * width,
            std::numeric_limits<float>::infinity());
  for (uint32_t n = bands.begin[band]; n < bands.begin[band + 1]; ++n) {
    const Flat &flat = flats[bands.flats[n]];
    for (int row = std::max(begin, flat.top); row < std::min(end, flat.bottom); ++row) {
      const double y = region[1] + row + 0.5;
      float *line = depth + static_cast<size_t>(row) * width;
      for (int column = flat.left; column < flat.right; ++column) {
        const double x = region[0] + column + 0.5;
        bool inside = true;
        for (const auto &edge : flat.edges) inside &= edge[0] * x + edge[1] * y + edge[2] >= 0;
        if (!inside) continue;
        const double inverse = flat.inverse[0] * x + flat.inverse[1] * y + flat.inverse[2];
        if (inverse > 0) line[column] = std::min(line[column], static_cast<float>(1 / inverse));
      }
    }
  }
}

}  // namespace
}  // namespace frog

int32_t frog_mesh_depth(const float *vertices, int32_t vertex_count, const int32_t *triangles, int32_t triangle_count,
                        const FrogCamera *camera, const int32_t region[4], float near_plane, float *depth) {
  if (vertex_count < 0 || triangle_count < 0 || !frog::lies_within(*camera, region)) return frog::BAD_SIZE;
  return frog::attempt([&] {
    std::vector<frog::Flat> flats;
    for (int t = 0; t < triangle_count; ++t) {
      frog::Point corners[3];
      bool usable = true;
      for (int i = 0; i < 3 && usable; ++i) {
        const int32_t index = triangles[3 * static_cast<size_t>(t) + i];
        const float *m = camera->world_to_camera;
        usable = index >= 0 && index < vertex_count;
        for (int r = 0; r < 3 && usable; ++r, m += 4) {
          const float *v = vertices + 3 * static_cast<size_t>(index);
          corners[i][r] = double(m[0]) * v[0] + double(m[1]) * v[1] + double(m[2]) * v[2] + m[3];
          usable = std::isfinite(corners[i][r]);
        }
      }
      if (usable) frog::clip(corners, near_plane, *camera, region, flats);
    }
    const int count = (region[3] + frog::BAND - 1) / frog::BAND;
    const frog::Bands bands = frog::sort_into_bands(flats, count);
    frog::parallel_each(count, [&](int band) { frog::draw_band(flats, bands, band, region, depth); });
  });
}
