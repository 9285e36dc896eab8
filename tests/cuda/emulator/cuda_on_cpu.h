// CUDA C++ on the CPU, for tests: as much of the language's extensions as the kernels use.
//
// A block's threads are fibers of one OS thread that change places where CUDA would synchronise them. What hardware
// forgives is an error here: a warp or barrier function that not all threads reach, and shared memory read before it
// is written (it starts as NaN in every block). The order in which threads run can be turned round: a missing barrier
// then shows as a different result.
#pragma once
#include <math.h>
#include <setjmp.h>
#include <stddef.h>
#include <stdint.h>
#include <stdio.h>
#include <string.h>
#include <ucontext.h>

#include <tuple>
#include <utility>
#include <vector>

#define __CUDACC__ 1
#define __global__
#define __device__
#define __forceinline__ inline
#define __launch_bounds__(...)
// One copy for the block that is running, in a section of its own so that it can be wiped between blocks.
#define __shared__ static __attribute__((section("frog_shared")))

struct float4 {
  float x, y, z, w;
};
static inline float4 make_float4(float x, float y, float z, float w) { return {x, y, z, w}; }

struct Index {
  unsigned x, y, z;
};
static Index threadIdx, blockIdx;

namespace emulator {

constexpr int LANES = 32;
enum State { RUNNING, AT_WARP, AT_BARRIER, DONE };

struct Fiber {
  ucontext_t start;
  jmp_buf here;
  State state;
  bool begun;
  unsigned phase;  // warp operations so far
};

struct Warp {
  uint64_t values[2][LANES];  // operations alternate, so that the next cannot overwrite what a slow lane still reads
  int arrived;
};

static std::vector<Fiber> fibers;
static std::vector<Warp> warps;
static std::vector<char> stacks;
static jmp_buf scheduler;
static unsigned current;
static int at_barrier, running;
static int barrier_any, barrier_any_last;
static constexpr size_t STACK = 64 << 10;

static inline void yield(State state) {
  fibers[current].state = state;
  if (!_setjmp(fibers[current].here)) _longjmp(scheduler, 1);
}

// Every lane's value of this operation.
static inline const uint64_t *exchange(unsigned mask, uint64_t value) {
  if (mask != 0xffffffffu) __builtin_trap();  // the kernels use whole warps only
  Warp &warp = warps[current / LANES];
  const unsigned phase = fibers[current].phase++ % 2;
  warp.values[phase][current % LANES] = value;
  if (++warp.arrived == LANES) {
    warp.arrived = 0;
    const unsigned first = current / LANES * LANES;
    for (unsigned i = first; i < first + LANES; ++i) fibers[i].state = RUNNING;
  } else {
    yield(AT_WARP);
  }
  return warp.values[phase];
}

static inline int barrier(int value) {
  barrier_any |= value != 0;
  if (++at_barrier == running) {
    at_barrier = 0;
    barrier_any_last = barrier_any;
    barrier_any = 0;
    for (Fiber &fiber : fibers)
      if (fiber.state == AT_BARRIER) fiber.state = RUNNING;
  } else {
    yield(AT_BARRIER);
  }
  return barrier_any_last;
}

template <class T>
static inline uint64_t pack(T value) {
  uint64_t bits = 0;
  static_assert(sizeof(T) <= sizeof(bits), "");
  memcpy(&bits, &value, sizeof(T));
  return bits;
}

template <class T>
static inline T unpack(uint64_t bits) {
  T value;
  memcpy(&value, &bits, sizeof(T));
  return value;
}

}  // namespace emulator

static inline void __syncthreads() { emulator::barrier(0); }
static inline int __syncthreads_or(int value) { return emulator::barrier(value); }

static inline unsigned __ballot_sync(unsigned mask, int value) {
  const uint64_t *all = emulator::exchange(mask, value != 0);
  unsigned bits = 0;
  for (int lane = 0; lane < emulator::LANES; ++lane) bits |= unsigned(all[lane]) << lane;
  return bits;
}
static inline int __any_sync(unsigned mask, int value) { return __ballot_sync(mask, value) != 0; }

template <class T>
static inline T __shfl_sync(unsigned mask, T value, int from) {
  return emulator::unpack<T>(emulator::exchange(mask, emulator::pack(value))[from % emulator::LANES]);
}
template <class T>
static inline T __shfl_xor_sync(unsigned mask, T value, int with) {
  const unsigned lane = threadIdx.x % emulator::LANES;
  return emulator::unpack<T>(emulator::exchange(mask, emulator::pack(value))[lane ^ with]);
}
template <class T>
static inline T __shfl_up_sync(unsigned mask, T value, int by) {
  const int lane = threadIdx.x % emulator::LANES;
  return emulator::unpack<T>(emulator::exchange(mask, emulator::pack(value))[lane >= by ? lane - by : lane]);
}

static inline int __ffs(unsigned bits) { return __builtin_ffs(int(bits)); }
static inline int __popc(unsigned bits) { return __builtin_popcount(bits); }
static inline int __clz(unsigned bits) { return bits ? __builtin_clz(bits) : 32; }
static inline float __frcp_rn(float value) { return 1 / value; }
static inline int max(int a, int b) { return a > b ? a : b; }
static inline int min(int a, int b) { return a < b ? a : b; }
static inline int __float_as_int(float value) { return emulator::unpack<int>(emulator::pack(value)); }
static inline float __int_as_float(int value) { return emulator::unpack<float>(emulator::pack(value)); }
static inline int atomicAdd(int *at, int value) { return (*at += value) - value; }
static inline int atomicSub(int *at, int value) { return atomicAdd(at, -value); }
static inline int atomicMax(int *at, int value) {
  const int old = *at;
  if (value > old) *at = value;
  return old;
}

extern "C" char __start_frog_shared[] __attribute__((weak)), __stop_frog_shared[] __attribute__((weak));

namespace emulator {

template <class... Arguments>
struct Launch {
  void (*kernel)(Arguments...);
  void **arguments;

  template <size_t... I>
  void call(std::index_sequence<I...>) {
    kernel(*static_cast<std::remove_reference_t<Arguments> *>(arguments[I])...);
  }

  static Launch *now;

  static void body() {
    now->call(std::index_sequence_for<Arguments...>{});
    fibers[current].state = DONE;
    _longjmp(scheduler, 1);
  }

  // Runs one thread until it waits or ends.
  static void resume(unsigned thread) {
    current = thread;
    threadIdx = {thread, 0, 0};
    Fiber &fiber = fibers[thread];
    if (_setjmp(scheduler)) return;
    if (fiber.begun) _longjmp(fiber.here, 1);
    fiber.begun = true;
    setcontext(&fiber.start);
  }

  // Runs a warp as far as it gets alone: the further warps drift apart, the more a missing barrier shows.
  static bool run_warp(unsigned warp, bool turned) {
    bool moved = false;
    for (bool again = true; again; moved |= again) {
      again = false;
      for (int n = 0; n < LANES; ++n) {
        const unsigned thread = warp * LANES + (turned ? LANES - 1 - n : n);
        if (fibers[thread].state != RUNNING) continue;
        again = true;
        resume(thread);
        if (fibers[thread].state == DONE) --running;
      }
    }
    return moved;
  }

  // Returns null, or what went wrong. `turned`: the last thread runs first.
  const char *run(unsigned blocks, unsigned threads, bool turned) {
    now = this;
    fibers.resize(threads);
    warps.assign(threads / LANES, Warp());
    stacks.resize(threads * STACK);
    for (unsigned block = 0; block < blocks; ++block) {
      blockIdx = {block, 0, 0};
      if (__start_frog_shared) memset(__start_frog_shared, 0xff, __stop_frog_shared - __start_frog_shared);
      at_barrier = barrier_any = 0;
      running = int(threads);
      for (unsigned thread = 0; thread < threads; ++thread) {
        Fiber &fiber = fibers[thread];
        fiber.state = RUNNING;
        fiber.begun = false;
        fiber.phase = 0;
        getcontext(&fiber.start);
        fiber.start.uc_stack.ss_sp = stacks.data() + thread * STACK;
        fiber.start.uc_stack.ss_size = STACK;
        fiber.start.uc_link = nullptr;
        makecontext(&fiber.start, body, 0);
      }
      while (running) {
        bool moved = false;
        for (unsigned n = 0; n < threads / LANES; ++n) moved |= run_warp(turned ? threads / LANES - 1 - n : n, turned);
        if (moved) continue;
        if (!running) break;
        return at_barrier ? "a barrier that not all threads reached" : "a warp operation that not all lanes reached";
      }
    }
    return nullptr;
  }
};

template <class... Arguments>
Launch<Arguments...> *Launch<Arguments...>::now;

template <class... Arguments>
const char *run(void (*kernel)(Arguments...), void **arguments, unsigned blocks, unsigned threads, bool turned) {
  Launch<Arguments...> launch = {kernel, arguments};
  return launch.run(blocks, threads, turned);
}

}  // namespace emulator
