// What web pages and viewports share of drawing a Gaussian: the engine's project_gaussian (native/src/shared) in GLSL.
// Whoever includes it defines SH_COUNT, LOW_PASS and coefficient(i, k), the k-th spherical harmonic of Gaussian i.

vec3 colour_of(int i, vec3 first, vec3 direction) {
  vec3 c = 0.5 + 0.28209479177387814 * first;
  float x = direction.x, y = direction.y, z = direction.z;
  if (SH_COUNT >= 4) {
    c += 0.4886025119029199 * (z * coefficient(i, 2) - y * coefficient(i, 1) - x * coefficient(i, 3));
  }
  float xx = x * x, yy = y * y, zz = z * z;
  if (SH_COUNT >= 9) {
    c += 1.0925484305920792 * (x * y * coefficient(i, 4) - y * z * coefficient(i, 5) - x * z * coefficient(i, 7));
    c += 0.31539156525252005 * (2.0 * zz - xx - yy) * coefficient(i, 6);
    c += 0.5462742152960396 * (xx - yy) * coefficient(i, 8);
  }
  if (SH_COUNT >= 16) {
    c -= 0.5900435899266435 * y * (3.0 * xx - yy) * coefficient(i, 9);
    c += 2.890611442640554 * x * y * z * coefficient(i, 10);
    c -= 0.4570457994644658 * y * (4.0 * zz - xx - yy) * coefficient(i, 11);
    c += 0.3731763325901154 * z * (2.0 * zz - 3.0 * xx - 3.0 * yy) * coefficient(i, 12);
    c -= 0.4570457994644658 * x * (4.0 * zz - xx - yy) * coefficient(i, 13);
    c += 1.445305721320277 * z * (xx - yy) * coefficient(i, 14);
    c -= 0.5900435899266435 * x * (xx - 3.0 * yy) * coefficient(i, 15);
  }
  return max(c, vec3(0.0));
}

mat3 rotation_of(vec4 q) {  // w, x, y, z
  q /= length(q);
  float w = q.x, x = q.y, y = q.z, z = q.w;
  return mat3(1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y + w * z), 2.0 * (x * z - w * y),
              2.0 * (x * y - w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z + w * x),
              2.0 * (x * z + w * y), 2.0 * (y * z - w * x), 1.0 - 2.0 * (x * x + y * y));
}

// The covariance of a splat in square pixels (xx, xy, yy), and its determinant.
//   local: the mean before the camera; camera: rows of the matrix to there; q, scale: of the Gaussian;
//   pinhole: fx, fy, cx, cy; extent: of the image in pixels.
vec4 covariance_of(vec3 local, mat3 camera, vec4 q, vec3 scale, vec4 pinhole, vec2 extent) {
  // The linearisation is clamped a little outside the image.
  vec2 focal = pinhole.xy, middle = pinhole.zw, margin = 0.15 * extent;
  vec2 at = clamp(local.xy / local.z, (-margin - middle) / focal, (extent + margin - middle) / focal);
  mat3 axes = rotation_of(q);
  axes[0] *= scale.x;
  axes[1] *= scale.y;
  axes[2] *= scale.z;
  vec3 row_z = camera[2] * axes;
  vec3 a = focal.x / local.z * (camera[0] * axes - at.x * row_z);
  vec3 b = focal.y / local.z * (camera[1] * axes - at.y * row_z);
  vec3 thin = cross(a, b);  // |a|^2 |b|^2 - (a.b)^2 = |a x b|^2: no cancellation for needles
  float determinant = dot(thin, thin) + LOW_PASS * (dot(a, a) + dot(b, b)) + LOW_PASS * LOW_PASS;
  return vec4(dot(a, a) + LOW_PASS, dot(a, b), dot(b, b) + LOW_PASS, determinant);
}
