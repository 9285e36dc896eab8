// World to screen for one Gaussian (EWA splatting), and back. Included after types.h.
#pragma once
#include "mathematics.h"

// Shared by both directions: everything the backward pass needs is cheaper to compute again than to store.
struct Projection {
  double local[3];  // camera space; in float a Gaussian close to a camera far from the origin has few digits
  float u, v;       // local x / z and y / z, clamped for the linearisation
  bool u_clamped, v_clamped;
  float quaternion[4], norm;      // unit, and the original length
  float rotation[3][3];           // of the Gaussian
  float jw[2][3];                 // J W: screen by world
  float jwr[2][3];                // J W R: screen by the Gaussian's own axes
  float axes[2][3];               // J W R S: columns are the splat's half axes in pixels
  float low;                      // the low-pass, variance in pixels^2
  float xx, xy, yy, determinant;  // screen covariance with the low-pass
};

FROG_FUNCTION bool finite(float value) { return fabsf(value) < 1e30f; }

// Whether the splat misses the region however the Gaussian is turned: as a ball of its largest scale and full opacity.
// Most Gaussians end here when a region is drawn, before the dear part of the projection.
FROG_FUNCTION bool far_outside(const Projection &p, const FrogCamera &camera, const FrogOptions &options, float u,
                               float v, const float *scales) {
  float square = 0, row_x = 0, row_y = 0;
  for (int k = 0; k < 3; ++k) {
    const float scale = scales[k] * scales[k];
    square = scale > square ? scale : square;
    row_x += p.jw[0][k] * p.jw[0][k];
    row_y += p.jw[1][k] * p.jw[1][k];
  }
  const float x = camera.fx * u + camera.cx - options.region[0], y = camera.fy * v + camera.cy - options.region[1];
  const float over_x = x < 0 ? x : x - options.region[2],
              over_y = y < 0 ? y : y - options.region[3];  // outside: how far
  constexpr float REACH = 2.02f / LOG2E * -LOG2_ALPHA_MIN;
  return ((x < 0 || over_x > 0) && over_x * over_x > REACH * (square * row_x + p.low)) ||
         ((y < 0 || over_y > 0) && over_y * over_y > REACH * (square * row_y + p.low));
}

// False where nothing is to be drawn: out of sight, or a number is not finite or out of range.
FROG_FUNCTION bool project_gaussian(const FrogGaussians &g, const FrogCamera &camera, const FrogOptions &options, int i,
                                    Projection &p) {
  const float *m = g.means + 3ll * i, *q = g.quaternions + 4ll * i, *s = g.scales + 3ll * i,
              *w = camera.world_to_camera;
  const float square = q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3];
  for (int r = 0; r < 3; ++r)
    p.local[r] = double(w[4 * r]) * m[0] + double(w[4 * r + 1]) * m[1] + double(w[4 * r + 2]) * m[2] + w[4 * r + 3];
  const float z = static_cast<float>(p.local[2]);
  if (!(square > 1e-24f && square < 1e24f && finite(p.local[0]) && finite(p.local[1]) && finite(z) &&
        fabsf(s[0]) < 1e12f && fabsf(s[1]) < 1e12f && fabsf(s[2]) < 1e12f && finite(g.opacities[i])))
    return false;
  if (!(z >= options.near_plane && g.opacities[i] > ALPHA_MIN)) return false;

  // The linearisation is clamped a little outside the image, whose centre need not be the principal point.
  const float margin_x = 0.15f * camera.width, margin_y = 0.15f * camera.height;
  const float u = static_cast<float>(p.local[0]) / z, v = static_cast<float>(p.local[1]) / z;
  p.u = clamped(u, (-margin_x - camera.cx) / camera.fx, (camera.width + margin_x - camera.cx) / camera.fx);
  p.v = clamped(v, (-margin_y - camera.cy) / camera.fy, (camera.height + margin_y - camera.cy) / camera.fy);
  p.u_clamped = p.u != u;
  p.v_clamped = p.v != v;
  const float jx = camera.fx / z, jy = camera.fy / z;
  for (int k = 0; k < 3; ++k) {
    p.jw[0][k] = jx * (w[k] - p.u * w[8 + k]);
    p.jw[1][k] = jy * (w[4 + k] - p.v * w[8 + k]);
  }
  p.low = options.low_passes ? options.low_passes[i] : options.low_pass;
  if (far_outside(p, camera, options, u, v, s)) return false;
  p.norm = sqrtf(square);
  for (int k = 0; k < 4; ++k) p.quaternion[k] = q[k] / p.norm;
  rotation_of(p.quaternion, p.rotation);
  for (int r = 0; r < 2; ++r)
    for (int k = 0; k < 3; ++k) {
      p.jwr[r][k] = p.jw[r][0] * p.rotation[0][k] + p.jw[r][1] * p.rotation[1][k] + p.jw[r][2] * p.rotation[2][k];
      p.axes[r][k] = p.jwr[r][k] * s[k];
    }
  const float *a = p.axes[0], *b = p.axes[1], low = p.low;
  const float aa = a[0] * a[0] + a[1] * a[1] + a[2] * a[2], bb = b[0] * b[0] + b[1] * b[1] + b[2] * b[2];
  const float cross[3] = {a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]};
  p.xx = aa + low;
  p.xy = a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
  p.yy = bb + low;
  // |a|^2 |b|^2 - (a.b)^2 = |a x b|^2: no cancellation for needles.
  const float thin_determinant = cross[0] * cross[0] + cross[1] * cross[1] + cross[2] * cross[2];
  p.determinant = thin_determinant + low * (aa + bb) + low * low;
  return p.determinant > 1e-12f && p.determinant < 1e30f;  // NaN fails both
}

// Unit direction from the camera to the Gaussian, in the world; returns the distance.
FROG_FUNCTION float view_direction(const FrogGaussians &g, const FrogCamera &camera, int i, float *direction) {
  const float *w = camera.world_to_camera, *m = g.means + 3ll * i;
  float square = 0;
  for (int k = 0; k < 3; ++k) {
    direction[k] = m[k] + (double(w[k]) * w[3] + double(w[4 + k]) * w[7] + double(w[8 + k]) * w[11]);
    square += direction[k] * direction[k];
  }
  const float distance = sqrtf(square);
  for (int k = 0; k < 3; ++k) direction[k] /= distance;
  return distance;
}

FROG_FUNCTION void colour_of(const FrogGaussians &g, const float *direction, int i, float *basis, float *colour) {
  sh_basis(g.sh_count, direction[0], direction[1], direction[2], basis);
  const float *sh = g.sh + static_cast<long long>(i) * g.sh_count * 3;
  for (int c = 0; c < 3; ++c) {
    colour[c] = 0.5f;
    for (int k = 0; k < g.sh_count; ++k) colour[c] += basis[k] * sh[3 * k + c];
  }
}

// Fills the splat of Gaussian i; of one that is not drawn only its radius, with zero.
FROG_FUNCTION void make_splat(const FrogGaussians &g, const FrogCamera &camera, const FrogOptions &options, int i,
                              Splat &splat) {
  splat.radius = 0;
  Projection p;
  if (!project_gaussian(g, camera, options, i, p)) return;
  const float opacity = g.opacities[i] < 1.0f ? g.opacities[i] : 1.0f;
  // Rounded before the region is taken off: the same bits in every region.
  splat.x = static_cast<float>(camera.fx * p.local[0] / p.local[2] + camera.cx) - options.region[0];
  splat.y = static_cast<float>(camera.fy * p.local[1] / p.local[2] + camera.cy) - options.region[1];
  splat.log2_opacity = log2f(opacity);
  const float reach = splat.log2_opacity - LOG2_ALPHA_MIN;  // what power may lose until alpha is ALPHA_MIN
  splat.extent_x = sqrtf(2 / LOG2E * reach * p.xx);
  splat.extent_y = sqrtf(2 / LOG2E * reach * p.yy);
  if (!(finite(splat.x) && finite(splat.y) && finite(splat.extent_x) && finite(splat.extent_y))) return;
  const float top = splat.y - splat.extent_y, bottom = splat.y + splat.extent_y;
  const float width = static_cast<float>(options.region[2]), height = static_cast<float>(options.region[3]);
  if (bottom < 0.5f || top > height - 0.5f || splat.x + splat.extent_x < 0.5f ||
      splat.x - splat.extent_x > width - 0.5f)
    return;

  float direction[3], basis[16], colour[3];
  view_direction(g, camera, i, direction);
  colour_of(g, direction, i, basis, colour);
  if (!(finite(colour[0]) && finite(colour[1]) && finite(colour[2]))) return;
  splat.red = colour[0] > 0 ? colour[0] : 0;
  splat.green = colour[1] > 0 ? colour[1] : 0;
  splat.blue = colour[2] > 0 ? colour[2] : 0;
  splat.depth = static_cast<float>(p.local[2]);
  // Inverse covariance (a, b; b, c) = (yy, -xy; -xy, xx) / det, completed: a (dx + b/a dy)^2 + dy^2 / yy.
  splat.along = sqrtf(0.5f * LOG2E * p.yy / p.determinant);
  splat.lean = -splat.along * p.xy / p.yy;
  splat.across = sqrtf(0.5f * LOG2E / p.yy);
  splat.widest = p.xy / p.xx * splat.extent_x;
  // Rows whose pixel centres (y + 1/2) lie in [top, bottom], with a margin for rounding.
  splat.first_row = static_cast<short>(static_cast<int>(clamped(top - 1, 0, height - 1)) / TILE);
  splat.last_row = static_cast<short>(static_cast<int>(clamped(bottom, 0, height - 1)) / TILE);
  splat.radius = splat.extent_x > splat.extent_y ? splat.extent_x : splat.extent_y;
}

// First and last tile of tile row `row` that the ellipse {alpha >= ALPHA_MIN} reaches; last < first when none. Exact
// for the band of the row's pixel centres.
FROG_FUNCTION void tile_span(const Splat &splat, int row, int width, int &first, int &last) {
  constexpr float MARGIN = 0.01f;  // pixels; covers rounding, every pixel is tested anyway
  const float top = row * TILE + 0.5f - splat.y, bottom = top + TILE - 1;
  const float low = top > -splat.extent_y ? top : -splat.extent_y;
  const float high = bottom < splat.extent_y ? bottom : splat.extent_y;
  first = 0;
  last = -1;
  if (low > high) return;
  const float reach = splat.log2_opacity - LOG2_ALPHA_MIN;
  const float right_dy = clamped(splat.widest, low, high), left_dy = clamped(-splat.widest, low, high);
  const float right_v = splat.across * right_dy, left_v = splat.across * left_dy;
  const float right_left = reach - right_v * right_v, left_left = reach - left_v * left_v;
  const float right = splat.x + (sqrtf(right_left > 0 ? right_left : 0) - splat.lean * right_dy) / splat.along + MARGIN;
  const float left = splat.x - (sqrtf(left_left > 0 ? left_left : 0) + splat.lean * left_dy) / splat.along - MARGIN;
  if (!(right >= 0.5f && left <= width)) return;
  const int first_pixel = static_cast<int>(ceilf(left > 0.5f ? left - 0.5f : 0.0f));
  const int last_pixel = static_cast<int>(floorf(right < width - 0.5f ? right - 0.5f : width - 1.0f));
  if (first_pixel > last_pixel) return;
  first = first_pixel / TILE;
  last = last_pixel / TILE;
}
