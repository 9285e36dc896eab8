// A stand-in for libcuda with the functions that launch.py calls. Its "machine code" is the path of a library that the
// emulator built, so that a launch through it really computes.
#include <dlfcn.h>
#include <string.h>

static int depth, contexts;  // pushed and not popped; retained
static int failing;          // what to answer launches with

extern "C" {
int cuInit(unsigned flags) { return flags ? 1 : 0; }
int cuDeviceGet(int *device, int ordinal) { return *device = ordinal + 40, 0; }
int cuDevicePrimaryCtxRetain(void **context, int device) {
  ++contexts;
  *context = reinterpret_cast<void *>(0x7f0012345678l + device);  // more than 32 bits must survive
  return 0;
}
int cuCtxPushCurrent_v2(void *context) {
  return ++depth, context == reinterpret_cast<void *>(0x7f0012345678l + 40) ? 0 : 201;
}
int cuCtxPopCurrent_v2(void **) { return --depth, 0; }
int cuModuleLoadData(void **module, const void *path) {
  return (*module = dlopen(static_cast<const char *>(path), RTLD_NOW)) && depth == 1 ? 0 : 200;
}
int cuModuleGetFunction(void **function, void *module, const char *name) {
  return *name && (*function = dlsym(module, "frog_launch")) ? 0 : 500;
}
int cuLaunchKernel(void *function, unsigned x, unsigned y, unsigned z, unsigned threads, unsigned threads_y,
                   unsigned threads_z, unsigned shared, void *stream, void **arguments, void **extra) {
  if (failing) return failing;
  if (y * z * threads_y * threads_z != 1 || shared || extra || depth != 1) return 1;
  if (stream != reinterpret_cast<void *>(0x7f00aaaabbbbl)) return 400;
  using Function = const char *(*)(void **, unsigned, unsigned, int);
  return reinterpret_cast<Function>(function)(arguments, x, threads, 0) ? 719 : 0;
}
int cuGetErrorString(int status, const char **text) {
  return *text = status == 719 ? "unspecified launch failure" : nullptr, 0;
}
int fake_depth() { return depth; }
int fake_contexts() { return contexts; }
void fake_fail(int status) { failing = status; }
}
