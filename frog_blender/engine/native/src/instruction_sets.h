// Which of the instruction sets that the kernels are compiled for this computer runs.
#pragma once

#if defined(FROG_X86)
#include <cpuid.h>

namespace frog {

struct InstructionSets {
  bool avx2 = false, avx512 = false;
};

// What the processor has and the system keeps. __builtin_cpu_supports would want a part of the compiler's library that
// Clang on Windows does not link, and in which Zig's finds nothing.
inline InstructionSets instruction_sets() {
  unsigned a, b, c, d, low, high;
  const auto all = [](unsigned bits, unsigned wanted) { return (bits & wanted) == wanted; };
  const unsigned fma = 1u << 12, xsave = 1u << 27, avx = 1u << 28, avx2 = 1u << 5;
  const unsigned f = 1u << 16, dq = 1u << 17, bw = 1u << 30, vl = 1u << 31;
  if (!__get_cpuid(1, &a, &b, &c, &d) || !all(c, fma | xsave | avx)) return {};
  if (!__get_cpuid_count(7, 0, &a, &b, &c, &d)) return {};
  __asm__ volatile("xgetbv" : "=a"(low), "=d"(high) : "c"(0));
#if defined(__APPLE__)
  const bool wide = true;  // macOS keeps the wide registers from their first use on, and says so only then
#else
  const bool wide = all(low, 0xe0);
#endif
  InstructionSets found;
  found.avx2 = all(b, avx2) && all(low, 0x6);
  found.avx512 = found.avx2 && wide && all(b, f | dq | bw | vl);
  return found;
}

}  // namespace frog
#endif
