// World to screen for every Gaussian (EWA splatting), and back.

// Shared by both directions: everything the backward pass needs is cheaper to compute again than to store.
struct Projection {
  float local[3];                // camera space
  float u, v;                    // local x / z and y / z, clamped for the linearisation
  bool u_clamped, v_clamped;
  float quaternion[4], norm;     // unit, and the original length
  float rotation[3][3];          // of the Gaussian
  float jw[2][3];                // J W: screen by world
  float jwr[2][3];               // J W R: screen by the Gaussian's own axes
  float axes[2][3];              // J W R S: columns are the splat's half axes in pixels
  float xx, xy, yy, determinant; // screen covariance with the low-pass
};

// False when the Gaussian cannot be drawn: behind the near plane, not finite, without a rotation.
static inline bool project_one(const FrogGaussians &g, const FrogCamera &camera, const FrogOptions &options, int i,
                               Projection &p) {
  const float *m = g.means + 3 * i, *q = g.quaternions + 4 * i, *s = g.scales + 3 * i, *w = camera.world_to_camera;
  for (int r = 0; r < 3; ++r) p.local[r] = w[4 * r] * m[0] + w[4 * r + 1] * m[1] + w[4 * r + 2] * m[2] + w[4 * r + 3];
  const float z = p.local[2];
  if (!(z >= options.near_plane)) return false;
  const float square = q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3];
  if (!(square > 1e-24f && square < 1e24f)) return false;
  p.norm = __builtin_sqrtf(square);
  for (int k = 0; k < 4; ++k) p.quaternion[k] = q[k] / p.norm;
  rotation_of(p.quaternion, p.rotation);

  // The linearisation is clamped a little outside the picture, whose centre need not be the principal point.
  const float margin_x = 0.15f * camera.width, margin_y = 0.15f * camera.height;
  const float u = p.local[0] / z, v = p.local[1] / z;
  p.u = clamped(u, (-margin_x - camera.cx) / camera.fx, (camera.width + margin_x - camera.cx) / camera.fx);
  p.v = clamped(v, (-margin_y - camera.cy) / camera.fy, (camera.height + margin_y - camera.cy) / camera.fy);
  p.u_clamped = p.u != u;
  p.v_clamped = p.v != v;
  const float jx = camera.fx / z, jy = camera.fy / z;
  for (int k = 0; k < 3; ++k) {
    p.jw[0][k] = jx * (w[k] - p.u * w[8 + k]);
    p.jw[1][k] = jy * (w[4 + k] - p.v * w[8 + k]);
  }
  for (int r = 0; r < 2; ++r)
    for (int k = 0; k < 3; ++k) {
      p.jwr[r][k] = p.jw[r][0] * p.rotation[0][k] + p.jw[r][1] * p.rotation[1][k] + p.jw[r][2] * p.rotation[2][k];
      p.axes[r][k] = p.jwr[r][k] * s[k];
    }
  const float *a = p.axes[0], *b = p.axes[1], low = options.low_pass;
  const float aa = a[0] * a[0] + a[1] * a[1] + a[2] * a[2], bb = b[0] * b[0] + b[1] * b[1] + b[2] * b[2];
  const float cross[3] = {a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]};
  p.xx = aa + low;
  p.xy = a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
  p.yy = bb + low;
  // |a|^2 |b|^2 - (a.b)^2 = |a x b|^2: no cancellation for needles.
  p.determinant = cross[0] * cross[0] + cross[1] * cross[1] + cross[2] * cross[2] + low * (aa + bb) + low * low;
  return p.determinant > 1e-12f && p.determinant < 1e30f;  // NaN fails both
}

// Unit direction from the camera to the Gaussian, in the world; returns the distance.
static inline float view_direction(const FrogGaussians &g, const FrogCamera &camera, int i, float *direction) {
  const float *w = camera.world_to_camera, *m = g.means + 3 * i;
  float square = 0;
  for (int k = 0; k < 3; ++k) {
    const float center = -(w[k] * w[3] + w[4 + k] * w[7] + w[8 + k] * w[11]);
    direction[k] = m[k] - center;
    square += direction[k] * direction[k];
  }
  const float distance = __builtin_sqrtf(square);
  for (int k = 0; k < 3; ++k) direction[k] /= distance;
  return distance;
}

static inline void colour_of(const FrogGaussians &g, const float *direction, int i, float *basis, float *colour) {
  sh_basis(g.sh_count, direction[0], direction[1], direction[2], basis);
  const float *sh = g.sh + static_cast<long>(i) * g.sh_count * 3;
  for (int c = 0; c < 3; ++c) {
    colour[c] = 0.5f;
    for (int k = 0; k < g.sh_count; ++k) colour[c] += basis[k] * sh[3 * k + c];
  }
}

static inline bool finite(float value) { return __builtin_fabsf(value) < 1e30f; }

static inline void project_splat(const FrameView &view, const FrogGaussians &g, int i, Splat &splat) {
  splat.radius = 0;
  Projection p;
  const float opacity = g.opacities[i] < 1.0f ? g.opacities[i] : 1.0f;
  if (!(opacity > ALPHA_MIN) || !(g.opacities[i] < 1e30f) || !project_one(g, view.camera, view.options, i, p)) return;
  float direction[3], basis[16], colour[3];
  view_direction(g, view.camera, i, direction);
  colour_of(g, direction, i, basis, colour);
  splat.x = view.camera.fx * p.local[0] / p.local[2] + view.camera.cx;
  splat.y = view.camera.fy * p.local[1] / p.local[2] + view.camera.cy;
  splat.a = p.yy / p.determinant;
  splat.b = -p.xy / p.determinant;
  splat.c = p.xx / p.determinant;
  splat.opacity = opacity;
  splat.red = colour[0] > 0 ? colour[0] : 0;
  splat.green = colour[1] > 0 ? colour[1] : 0;
  splat.blue = colour[2] > 0 ? colour[2] : 0;
  splat.depth = p.local[2];
  splat.cutoff = 2 * logf(opacity / ALPHA_MIN);
  splat.extent_x = __builtin_sqrtf(splat.cutoff * p.xx);
  splat.extent_y = __builtin_sqrtf(splat.cutoff * p.yy);
  splat.lean = p.xy / p.xx * splat.extent_x;
  if (!(finite(splat.x) && finite(splat.y) && finite(splat.extent_x) && finite(splat.extent_y) && finite(colour[0]) &&
        finite(colour[1]) && finite(colour[2])))
    return;
  const float top = splat.y - splat.extent_y, bottom = splat.y + splat.extent_y;
  const float height = static_cast<float>(view.camera.height), width = static_cast<float>(view.camera.width);
  if (bottom < 0.5f || top > height - 0.5f || splat.x + splat.extent_x < 0.5f || splat.x - splat.extent_x > width - 0.5f)
    return;
  // Rows whose pixel centres (y + 1/2) lie in [top, bottom], with a margin for rounding.
  splat.first_row = static_cast<int16_t>(static_cast<int>(clamped(top - 1, 0, height - 1)) / TILE);
  splat.last_row = static_cast<int16_t>(static_cast<int>(clamped(bottom, 0, height - 1)) / TILE);
  splat.radius = splat.extent_x > splat.extent_y ? splat.extent_x : splat.extent_y;
}

static void project(const FrameView &view, const FrogGaussians &g, int begin, int end) {
  for (int i = begin; i < end; ++i) project_splat(view, g, i, view.splats[i]);
}

static inline void project_backward_one(const FrameView &view, const FrogGaussians &g, const FrogGradients &out, int i) {
  const FrogCamera &camera = view.camera;
  const float *w = camera.world_to_camera, *s = g.scales + 3 * i;
  const Splat &splat = view.splats[i];
  float d[INSTANCE_GRADIENTS] = {};
  for (uint32_t slot = view.slot_begin[i]; slot < view.slot_begin[i + 1]; ++slot)
    for (int k = 0; k < INSTANCE_GRADIENTS; ++k) d[k] += view.instance_gradients[static_cast<size_t>(slot) * INSTANCE_GRADIENTS + k];
  Projection p;
  project_one(g, camera, view.options, i, p);
  out.opacities[i] = g.opacities[i] <= 1.0f ? d[5] : 0;
  out.screen[2 * i] = d[0];
  out.screen[2 * i + 1] = d[1];

  // Colour: by the coefficients, and by the viewing direction.
  float direction[3], basis[16], basis_gradient[16][3], colour[3], by_direction[3] = {};
  const float distance = view_direction(g, camera, i, direction);
  colour_of(g, direction, i, basis, colour);
  sh_basis_gradient(g.sh_count, direction[0], direction[1], direction[2], basis_gradient);
  const float *sh = g.sh + static_cast<long>(i) * g.sh_count * 3;
  float *sh_out = out.sh + static_cast<long>(i) * g.sh_count * 3;
  for (int c = 0; c < 3; ++c) {
    const float by_colour = colour[c] > 0 ? d[6 + c] : 0;
    for (int k = 0; k < g.sh_count; ++k) {
      sh_out[3 * k + c] = by_colour * basis[k];
      for (int e = 0; e < 3; ++e) by_direction[e] += by_colour * sh[3 * k + c] * basis_gradient[k][e];
    }
  }
  const float along = by_direction[0] * direction[0] + by_direction[1] * direction[1] + by_direction[2] * direction[2];
  float *mean_out = out.means + 3 * i;
  for (int e = 0; e < 3; ++e) mean_out[e] = (by_direction[e] - along * direction[e]) / distance;

  // Inverse covariance Q -> covariance: dL/dC = -Q (dL/dQ) Q with symmetric matrices.
  const float qa = splat.a, qb = splat.b, qc = splat.c, ga = d[2], gb = d[3] / 2, gc = d[4];
  const float ta = qa * ga + qb * gb, tb = qa * gb + qb * gc, tc = qb * ga + qc * gb, td = qb * gb + qc * gc;
  const float by_xx = -(ta * qa + tb * qb), by_xy = -(ta * qb + tb * qc), by_yy = -(tc * qb + td * qc);

  // Covariance = axes axes^T + low-pass; axes = J W R S.
  float by_jwr[2][3], by_jw[2][3], by_rotation[3][3];
  float *scale_out = out.scales + 3 * i;
  for (int k = 0; k < 3; ++k) {
    const float by_axis_x = 2 * (by_xx * p.axes[0][k] + by_xy * p.axes[1][k]);
    const float by_axis_y = 2 * (by_xy * p.axes[0][k] + by_yy * p.axes[1][k]);
    scale_out[k] = by_axis_x * p.jwr[0][k] + by_axis_y * p.jwr[1][k];
    by_jwr[0][k] = by_axis_x * s[k];
    by_jwr[1][k] = by_axis_y * s[k];
  }
  for (int r = 0; r < 3; ++r) {
    for (int row = 0; row < 2; ++row)
      by_jw[row][r] = by_jwr[row][0] * p.rotation[r][0] + by_jwr[row][1] * p.rotation[r][1] + by_jwr[row][2] * p.rotation[r][2];
    for (int k = 0; k < 3; ++k) by_rotation[r][k] = p.jw[0][r] * by_jwr[0][k] + p.jw[1][r] * by_jwr[1][k];
  }
  rotation_gradient(p.quaternion, p.norm, by_rotation, out.quaternions + 4 * i);

  // J W depends on the position through 1/z and the (unclamped) u and v.
  const float z = p.local[2], jx = camera.fx / z, jy = camera.fy / z;
  float by_u = 0, by_v = 0, by_z = 0;
  for (int k = 0; k < 3; ++k) {
    by_u -= by_jw[0][k] * jx * w[8 + k];
    by_v -= by_jw[1][k] * jy * w[8 + k];
    by_z -= (by_jw[0][k] * p.jw[0][k] + by_jw[1][k] * p.jw[1][k]) / z;
  }
  float by_x = d[0] * jx, by_y = d[1] * jy;
  by_z -= (d[0] * jx * p.local[0] + d[1] * jy * p.local[1]) / z;
  if (!p.u_clamped) by_x += by_u / z, by_z -= by_u * p.u / z;
  if (!p.v_clamped) by_y += by_v / z, by_z -= by_v * p.v / z;
  for (int e = 0; e < 3; ++e) mean_out[e] += w[e] * by_x + w[4 + e] * by_y + w[8 + e] * by_z;
}

static void project_backward(const FrameView &view, const FrogGaussians &g, const FrogGradients &out, int begin, int end) {
  for (int i = begin; i < end; ++i) {
    if (view.splats[i].radius > 0 && view.slot_begin[i] < view.slot_begin[i + 1]) {
      project_backward_one(view, g, out, i);
      continue;
    }
    for (int k = 0; k < 3; ++k) out.means[3 * i + k] = out.scales[3 * i + k] = 0;
    for (int k = 0; k < 4; ++k) out.quaternions[4 * i + k] = 0;
    for (int k = 0; k < 3 * g.sh_count; ++k) out.sh[static_cast<long>(i) * 3 * g.sh_count + k] = 0;
    out.opacities[i] = out.screen[2 * i] = out.screen[2 * i + 1] = 0;
  }
}
