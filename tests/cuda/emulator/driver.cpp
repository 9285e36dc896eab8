// One kernel as a shared library: compiled with -DKERNEL=blend -DKERNEL_FILE="blend.cu" and the kernel's constants.
#include "cuda_on_cpu.h"
#include KERNEL_FILE

extern "C" const char *frog_launch(void **arguments, unsigned blocks, unsigned threads, int turned) {
  return emulator::run(KERNEL, arguments, blocks, threads, turned != 0);
}
