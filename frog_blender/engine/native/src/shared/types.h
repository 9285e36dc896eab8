// Structs and constants of the rasterizer that the C interface, the CPU kernels and the CUDA kernels share.
// No system header: the CUDA run-time compiler reads this file as it is. `int` has 32 bits everywhere.
#pragma once

#if defined(__CUDACC__)
#define FROG_FUNCTION static __device__ __forceinline__
#else
#define FROG_FUNCTION static inline
#endif

constexpr int TILE = 16;                               // pixels a side
constexpr float ALPHA_MIN = 1.0f / 255;                // fainter contributions are skipped
constexpr float ALPHA_MAX = 0.999f;                    // keeps 1 - alpha away from zero
constexpr float TRANSMITTANCE_MIN = 1e-4f;             // a pixel that would fall below is finished
constexpr float LOG2_ALPHA_MIN = -7.994353436858858f;  // log2(ALPHA_MIN)
constexpr float LOG2_ALPHA_MAX = -1.4434168696687186e-3f;
constexpr float LOG2E = 1.4426950408889634f;

// Every array is float32, row-major and contiguous.
typedef struct {
  int count;                 // N
  int sh_count;              // K = 1, 4, 9 or 16 coefficients a channel
  const float *means;        // (N, 3) world units
  const float *quaternions;  // (N, 4) w x y z, any length but zero
  const float *scales;       // (N, 3) standard deviations, world units
  const float *opacities;    // (N,) in [0, 1]
  const float *sh;           // (N, K, 3)
} FrogGaussians;

typedef struct {
  float world_to_camera[12];  // upper three rows of the 4x4 matrix
  float fx, fy, cx, cy;       // pixels
  int width, height;          // pixels
} FrogCamera;

typedef struct {
  float background[3];
  float low_pass;    // variance in pixels^2 added to each splat's screen covariance, without low_passes
  float near_plane;  // planar depth below which a Gaussian is culled, world units
  int region[4];     // left, top, width, height: the part of the camera's image that is drawn, pixels
  const float
      *depth_limit;  // (height, width) of the region: Gaussians of larger planar depth are hidden there (or null)
  const float *low_passes;  // (N,) each splat's own (or null)
} FrogOptions;

typedef struct {
  float *means, *quaternions, *scales, *opacities, *sh;  // shapes as in FrogGaussians
  float *screen;                                         // (N, 2) gradient of the pixel position
  float *pose;                                           // (12,) gradient of world_to_camera (or null)
} FrogGradients;

// A parameter of `size` numbers and what Adam remembers of it. The step is rate * first / (sqrt(second) * second_scale
// + epsilon): the corrections for memories that began at zero are in `rate` and `second_scale`.
typedef struct {
  float *values;
  const float *gradients;
  float *first, *second;  // running means of the gradient and of its square
  long long size;
  float first_share, second_share;  // of a new gradient in them
  float rate, second_scale, epsilon;
} FrogAdam;

// A Gaussian on the screen, in pixels of the drawn region. `radius` is 0 for one that is not drawn.
// Its alpha at (dx, dy) from the centre is 2^power, power = log2_opacity - u^2 - v^2 with u = along dx + lean dy and
// v = across dy: the square is completed, so that needles lose no digits.
struct alignas(64) Splat {
  float x, y;
  float along, lean, across;
  float log2_opacity;
  float red, green, blue;
  float depth;                // planar, world units
  float extent_x, extent_y;   // half sides of the box outside which alpha < ALPHA_MIN
  float radius;               // the larger of the two
  float widest;               // dy at which the ellipse reaches its largest dx
  short first_row, last_row;  // tile rows, inclusive
};

// What a splat's pixels send back, summed: moments of g = dL/d(log alpha) in u and v, which are of the order of one
// whatever the splat's shape, and dL/d(red, green, blue).
enum SplatGradient {
  SUM_U,
  SUM_V,
  SUM_UU,
  SUM_UV,
  SUM_VV,  // of g u, g v, g u^2, g u v, g v^2
  SUM_1,   // of g
  BY_RED,
  BY_GREEN,
  BY_BLUE,
  SPLAT_GRADIENTS
};
