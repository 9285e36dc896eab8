// Loads the library that is named, as the binding does, and draws one Gaussian with it. Ends with 0 when the image is
// right. For emulators, which have no Python: tools/cross_build.py --wine, --qemu.
#include <cstdio>
#include <vector>

#include "frog_native.h"

#if defined(_WIN32)
#include <windows.h>
static void *find(const char *path, const char *name) {
  HMODULE library = LoadLibraryA(path);
  return library ? reinterpret_cast<void *>(GetProcAddress(library, name)) : nullptr;
}
#else
#include <dlfcn.h>
static void *find(const char *path, const char *name) {
  void *library = dlopen(path, RTLD_NOW);
  return library ? dlsym(library, name) : nullptr;
}
#endif

int main(int count, char **arguments) {
  if (count != 2) return std::printf("usage: draw_one LIBRARY\n"), 2;
  const char *path = arguments[1];
  const auto version = reinterpret_cast<decltype(&frog_abi_version)>(find(path, "frog_abi_version"));
  const auto kernels = reinterpret_cast<decltype(&frog_instruction_set)>(find(path, "frog_instruction_set"));
  const auto draw = reinterpret_cast<decltype(&frog_draw)>(find(path, "frog_draw"));
  const auto release = reinterpret_cast<decltype(&frog_free)>(find(path, "frog_free"));
  if (!version || !kernels || !draw || !release) return std::printf("%s: not loaded\n", path), 1;

  constexpr int SIDE = 64;
  const float mean[3] = {0, 0, 4}, quaternion[4] = {1, 0, 0, 0}, scale[3] = {0.4f, 0.4f, 0.4f}, opacity = 0.9f;
  const float color[3] = {1, 1, 1};
  FrogGaussians gaussians{1, 1, mean, quaternion, scale, &opacity, color};
  FrogCamera camera{{1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0}, 40, 40, 32, 32, SIDE, SIDE};
  FrogOptions options{};
  options.low_pass = 0.3f, options.near_plane = 0.01f;
  options.region[2] = options.region[3] = SIDE;
  std::vector<float> rgb(SIDE * SIDE * 3), alpha(SIDE * SIDE);
  FrogImage image{};
  image.rgb = rgb.data(), image.alpha = alpha.data();
  FrogFrame *frame = draw(&gaussians, &camera, &options, &image, 0);
  if (!frame) return std::printf("%s: drew nothing\n", path), 1;
  release(frame);
  const float middle = alpha[32 * SIDE + 32], corner = alpha[0];
  std::printf("interface %d, kernels %s, alpha %.4f in the middle, %.4f in a corner\n", static_cast<int>(version()),
              kernels(), middle, corner);
  return middle > 0.85f && middle < 0.91f && corner < 0.01f ? 0 : 1;
}
