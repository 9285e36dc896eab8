// Small fixed-size mathematics of the projection: spherical harmonics and quaternions, with their derivatives.
#pragma once

// Real spherical harmonics in the order of 3D Gaussian Splatting, up to degree 3, at the unit direction (x, y, z).
FROG_FUNCTION void sh_basis(int count, float x, float y, float z, float *b) {
  b[0] = 0.28209479177387814f;
  if (count < 4) return;
  b[1] = -0.4886025119029199f * y;
  b[2] = 0.4886025119029199f * z;
  b[3] = -0.4886025119029199f * x;
  if (count < 9) return;
  const float xx = x * x, yy = y * y, zz = z * z;
  b[4] = 1.0925484305920792f * x * y;
  b[5] = -1.0925484305920792f * y * z;
  b[6] = 0.31539156525252005f * (2 * zz - xx - yy);
  b[7] = -1.0925484305920792f * x * z;
  b[8] = 0.5462742152960396f * (xx - yy);
  if (count < 16) return;
  b[9] = -0.5900435899266435f * y * (3 * xx - yy);
  b[10] = 2.890611442640554f * x * y * z;
  b[11] = -0.4570457994644658f * y * (4 * zz - xx - yy);
  b[12] = 0.3731763325901154f * z * (2 * zz - 3 * xx - 3 * yy);
  b[13] = -0.4570457994644658f * x * (4 * zz - xx - yy);
  b[14] = 1.445305721320277f * z * (xx - yy);
  b[15] = -0.5900435899266435f * x * (xx - 3 * yy);
}

// Derivatives of the same polynomials by x, y and z: d[k] = {db_k/dx, db_k/dy, db_k/dz}.
FROG_FUNCTION void sh_basis_gradient(int count, float x, float y, float z, float (*d)[3]) {
  for (int k = 0; k < count; ++k) d[k][0] = d[k][1] = d[k][2] = 0;
  if (count < 4) return;
  d[1][1] = -0.4886025119029199f;
  d[2][2] = 0.4886025119029199f;
  d[3][0] = -0.4886025119029199f;
  if (count < 9) return;
  const float c4 = 1.0925484305920792f, c6 = 0.31539156525252005f, c8 = 0.5462742152960396f;
  d[4][0] = c4 * y;
  d[4][1] = c4 * x;
  d[5][1] = -c4 * z;
  d[5][2] = -c4 * y;
  d[6][0] = -2 * c6 * x;
  d[6][1] = -2 * c6 * y;
  d[6][2] = 4 * c6 * z;
  d[7][0] = -c4 * z;
  d[7][2] = -c4 * x;
  d[8][0] = 2 * c8 * x;
  d[8][1] = -2 * c8 * y;
  if (count < 16) return;
  const float xx = x * x, yy = y * y, zz = z * z;
  const float c9 = 0.5900435899266435f, c10 = 2.890611442640554f, c11 = 0.4570457994644658f, c12 = 0.3731763325901154f,
              c14 = 1.445305721320277f;
  d[9][0] = -6 * c9 * x * y;
  d[9][1] = -3 * c9 * (xx - yy);
  d[10][0] = c10 * y * z;
  d[10][1] = c10 * x * z;
  d[10][2] = c10 * x * y;
  d[11][0] = 2 * c11 * x * y;
  d[11][1] = -c11 * (4 * zz - xx - 3 * yy);
  d[11][2] = -8 * c11 * y * z;
  d[12][0] = -6 * c12 * x * z;
  d[12][1] = -6 * c12 * y * z;
  d[12][2] = c12 * (6 * zz - 3 * xx - 3 * yy);
  d[13][0] = -c11 * (4 * zz - 3 * xx - yy);
  d[13][1] = 2 * c11 * x * y;
  d[13][2] = -8 * c11 * x * z;
  d[14][0] = 2 * c14 * x * z;
  d[14][1] = -2 * c14 * y * z;
  d[14][2] = c14 * (xx - yy);
  d[15][0] = -3 * c9 * (xx - yy);
  d[15][1] = 6 * c9 * x * y;
}

// Rotation matrix of the unit quaternion (w, x, y, z).
FROG_FUNCTION void rotation_of(const float *q, float r[3][3]) {
  const float w = q[0], x = q[1], y = q[2], z = q[3];
  r[0][0] = 1 - 2 * (y * y + z * z);
  r[0][1] = 2 * (x * y - w * z);
  r[0][2] = 2 * (x * z + w * y);
  r[1][0] = 2 * (x * y + w * z);
  r[1][1] = 1 - 2 * (x * x + z * z);
  r[1][2] = 2 * (y * z - w * x);
  r[2][0] = 2 * (x * z - w * y);
  r[2][1] = 2 * (y * z + w * x);
  r[2][2] = 1 - 2 * (x * x + y * y);
}

// Gradient by the unnormalised quaternion (length `norm`, direction q) from the gradient by the rotation matrix.
FROG_FUNCTION void rotation_gradient(const float *q, float norm, const float g[3][3], float *out) {
  const float w = q[0], x = q[1], y = q[2], z = q[3];
  float d[4];
  d[0] = 2 * (x * (g[2][1] - g[1][2]) + y * (g[0][2] - g[2][0]) + z * (g[1][0] - g[0][1]));
  d[1] =
      2 * (y * (g[0][1] + g[1][0]) + z * (g[0][2] + g[2][0]) + w * (g[2][1] - g[1][2]) - 2 * x * (g[1][1] + g[2][2]));
  d[2] =
      2 * (x * (g[0][1] + g[1][0]) + z * (g[1][2] + g[2][1]) + w * (g[0][2] - g[2][0]) - 2 * y * (g[0][0] + g[2][2]));
  d[3] =
      2 * (x * (g[0][2] + g[2][0]) + y * (g[1][2] + g[2][1]) + w * (g[1][0] - g[0][1]) - 2 * z * (g[0][0] + g[1][1]));
  const float along = d[0] * w + d[1] * x + d[2] * y + d[3] * z;
  for (int i = 0; i < 4; ++i) out[i] = (d[i] - along * q[i]) / norm;
}

FROG_FUNCTION float clamped(float value, float low, float high) {
  return value < low ? low : (value > high ? high : value);
}
