// One step of Adam for several parameters: each has blocks of its own.
#include "adam.h"
#include "common.cuh"

constexpr int MOST = 24;                 // parameters; MOST in adam.py
constexpr int SHARE = 4 * THREADS;       // numbers that a block takes; in adam.py too

struct Steps {
  FrogAdam each[MOST];
  int first_block[MOST + 1];
};

// Nothing is written where `state` (2,) says that the drawing's pairs had no room.
extern "C" __global__ void __launch_bounds__(THREADS) adam(Steps steps, const long long *state) {
  if (state && state[1]) return;
  const int block = blockIdx.x;
  int which = 0;
  while (block >= steps.first_block[which + 1]) ++which;
  const FrogAdam &parameter = steps.each[which];
  const long long begin = static_cast<long long>(block - steps.first_block[which]) * SHARE;
  for (int n = threadIdx.x; n < SHARE && begin + n < parameter.size; n += THREADS) adam_step(parameter, begin + n);
}
