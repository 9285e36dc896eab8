// Gradients of one Gaussian's attributes, and of the camera's pose, from what its pixels sent back.
#pragma once
#include "projection.h"

FROG_FUNCTION void no_gradient(const FrogGaussians &g, const FrogGradients &out, int i) {
  for (int k = 0; k < 3; ++k) out.means[3ll * i + k] = out.scales[3ll * i + k] = 0;
  for (int k = 0; k < 4; ++k) out.quaternions[4ll * i + k] = 0;
  for (int k = 0; k < 3 * g.sh_count; ++k) out.sh[static_cast<long long>(i) * 3 * g.sh_count + k] = 0;
  out.opacities[i] = out.screen[2ll * i] = out.screen[2ll * i + 1] = 0;
}

// Colour: by the coefficients, and by the viewing direction (unnormalised), which is left in `by_offset`.
FROG_FUNCTION void colour_backward(const FrogGaussians &g, const FrogCamera &camera, int i, const float *by_colour,
                                   float *sh_out, float *by_offset) {
  float direction[3], basis[16], basis_gradient[16][3], colour[3], by_direction[3] = {0, 0, 0};
  const float distance = view_direction(g, camera, i, direction);
  colour_of(g, direction, i, basis, colour);
  sh_basis_gradient(g.sh_count, direction[0], direction[1], direction[2], basis_gradient);
  const float *sh = g.sh + static_cast<long long>(i) * g.sh_count * 3;
  for (int c = 0; c < 3; ++c) {
    const float by = colour[c] > 0 ? by_colour[c] : 0;
    for (int k = 0; k < g.sh_count; ++k) {
      sh_out[3 * k + c] = by * basis[k];
      for (int e = 0; e < 3; ++e) by_direction[e] += by * sh[3 * k + c] * basis_gradient[k][e];
    }
  }
  const float along = by_direction[0] * direction[0] + by_direction[1] * direction[1] + by_direction[2] * direction[2];
  for (int e = 0; e < 3; ++e) by_offset[e] = (by_direction[e] - along * direction[e]) / distance;
}

// Writes the gradients of Gaussian i, which was drawn. `sums` are its SPLAT_GRADIENTS numbers; its share of the pose's
// gradient is added to `pose` (12,) unless that is null.
FROG_FUNCTION void splat_backward(const FrogGaussians &g, const FrogCamera &camera, const FrogOptions &options, int i,
                                  const float *sums, const FrogGradients &out, float *pose) {
  const float *w = camera.world_to_camera, *s = g.scales + 3ll * i, *m = g.means + 3ll * i;
  Projection p;
  project_gaussian(g, camera, options, i, p);
  out.opacities[i] = g.opacities[i] <= 1.0f ? sums[SUM_1] / g.opacities[i] : 0;

  // (u, v) = T (dx, dy) whitens the splat: its inverse covariance is S T^T T with S = 2 / log2 e. With M the moments of
  // second order, dL/d(position) = S T^T (sum g u, sum g v) and dL/d(covariance) = S^2 / 2 T^T M T. Everything stays in
  // u and v as long as it can: in pixels a needle's numbers would cancel to nothing.
  constexpr float S = 2 / LOG2E;
  const float along = sqrtf(p.yy / (S * p.determinant)), lean = -along * p.xy / p.yy, across = sqrtf(1 / (S * p.yy));
  const float by_pixel_x = S * along * sums[SUM_U], by_pixel_y = S * (lean * sums[SUM_U] + across * sums[SUM_V]);
  out.screen[2ll * i] = by_pixel_x;
  out.screen[2ll * i + 1] = by_pixel_y;

  // Covariance = axes axes^T + low-pass; axes = J W R S_k, one column for each of the Gaussian's own axes.
  const float *a = p.axes[0], *b = p.axes[1], low = p.low;
  float by_jwr[2][3], by_jw[2][3], by_rotation[3][3];
  for (int k = 0; k < 3; ++k) {
    // The column without its scale in u and v. u = along / yy (x yy - xy y), written out so that the long axis's own
    // product with itself, which cancels, never appears.
    const float x = p.jwr[0][k], y = p.jwr[1][k];
    const int j = (k + 1) % 3, l = (k + 2) % 3;
    const float u = along / p.yy * (low * x + b[j] * (x * b[j] - a[j] * y) + b[l] * (x * b[l] - a[l] * y)),
                v = across * y;
    const float by_u = S * S * (sums[SUM_UU] * u + sums[SUM_UV] * v),
                by_v = S * S * (sums[SUM_UV] * u + sums[SUM_VV] * v);
    const float by_axis_x = along * by_u * s[k], by_axis_y = (lean * by_u + across * by_v) * s[k];
    out.scales[3ll * i + k] = (u * by_u + v * by_v) * s[k];
    by_jwr[0][k] = by_axis_x * s[k];
    by_jwr[1][k] = by_axis_y * s[k];
  }
  for (int r = 0; r < 3; ++r) {
    for (int row = 0; row < 2; ++row)
      by_jw[row][r] =
          by_jwr[row][0] * p.rotation[r][0] + by_jwr[row][1] * p.rotation[r][1] + by_jwr[row][2] * p.rotation[r][2];
    for (int k = 0; k < 3; ++k) by_rotation[r][k] = p.jw[0][r] * by_jwr[0][k] + p.jw[1][r] * by_jwr[1][k];
  }
  rotation_gradient(p.quaternion, p.norm, by_rotation, out.quaternions + 4ll * i);

  // J W depends on the position through 1/z and the (unclamped) u and v.
  const float z = static_cast<float>(p.local[2]), jx = camera.fx / z, jy = camera.fy / z;
  float by_u = 0, by_v = 0, by_local[3] = {by_pixel_x * jx, by_pixel_y * jy, 0};
  for (int k = 0; k < 3; ++k) {
    by_u -= by_jw[0][k] * jx * w[8 + k];
    by_v -= by_jw[1][k] * jy * w[8 + k];
    by_local[2] -= (by_jw[0][k] * p.jw[0][k] + by_jw[1][k] * p.jw[1][k]) / z;
  }
  by_local[2] -= (by_pixel_x * jx * p.local[0] + by_pixel_y * jy * p.local[1]) / z;
  if (!p.u_clamped) by_local[0] += by_u / z, by_local[2] -= by_u * p.u / z;
  if (!p.v_clamped) by_local[1] += by_v / z, by_local[2] -= by_v * p.v / z;

  float by_offset[3];
  colour_backward(g, camera, i, sums + BY_RED, out.sh + static_cast<long long>(i) * g.sh_count * 3, by_offset);
  for (int e = 0; e < 3; ++e)
    out.means[3ll * i + e] = by_offset[e] + w[e] * by_local[0] + w[4 + e] * by_local[1] + w[8 + e] * by_local[2];
  if (!pose) return;

  // The pose moves the Gaussian in camera space, turns J W, and moves the centre that colours are seen from:
  // offset = m + R^T t.
  const float by_j[2] = {jx, jy}, uv[2] = {p.u, p.v};
  for (int row = 0; row < 2; ++row)
    for (int k = 0; k < 3; ++k) {
      pose[4 * row + k] += by_jw[row][k] * by_j[row];
      pose[8 + k] -= by_jw[row][k] * by_j[row] * uv[row];
    }
  for (int r = 0; r < 3; ++r) {
    for (int k = 0; k < 3; ++k) {
      pose[4 * r + k] += by_local[r] * m[k] + by_offset[k] * w[4 * r + 3];
      pose[4 * r + 3] += by_offset[k] * w[4 * r + k];
    }
    pose[4 * r + 3] += by_local[r];
  }
}
