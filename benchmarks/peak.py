"""Measures how much single-precision arithmetic one core of this machine can do.

    python benchmarks/peak.py

A few lines of C++ are compiled for this processor: independent chains of fused multiply-adds on its widest vectors (the
peak), and one chain of integer additions that each wait for the one before (a cycle each, hence the clock).
One core is measured while the others rest; where all are busy the clock, and the peak with it, may be lower.
"""

from __future__ import annotations

import functools
import os
import shutil
import subprocess
import tempfile
from dataclasses import dataclass
from pathlib import Path

SOURCE = r"""
#include <chrono>
#include <cstdint>
#include <cstdio>

#if defined(__AVX512F__)
constexpr int BYTES = 64;
#elif defined(__AVX__)
constexpr int BYTES = 32;
#else
constexpr int BYTES = 16;
#endif
constexpr int LANES = BYTES / 4;
constexpr int CHAINS = 12;  // covers the latency of two units; fits into sixteen registers with the two factors
constexpr int64_t STEPS = 500000;  // a millisecond or two: what interrupts one measurement spares another
constexpr int REPEATS = 60;
typedef float Vector __attribute__((vector_size(BYTES)));

static double now() {
  using namespace std::chrono;
  return duration<double>(steady_clock::now().time_since_epoch()).count();
}

static Vector chains(Vector factor, Vector term) {
  Vector x[CHAINS];
  for (int i = 0; i < CHAINS; ++i) x[i] = factor * static_cast<float>(i);
  for (int64_t n = 0; n < STEPS; ++n)
#pragma GCC unroll 12
    for (int i = 0; i < CHAINS; ++i) x[i] = x[i] * factor + term;
  for (int i = 1; i < CHAINS; ++i) x[0] += x[i];
  return x[0];
}

static uint64_t additions(uint64_t x, uint64_t step) {
  for (int64_t n = 0; n < STEPS; ++n)
#pragma GCC unroll 16
    for (int i = 0; i < 16; ++i) {
      x += step;
      __asm__ volatile("" : "+r"(x));  // else the compiler multiplies
    }
  return x;
}

int main(int argc, char **) {
  Vector factor, term;
  for (int i = 0; i < LANES; ++i) factor[i] = 0.5f + 0.01f * argc, term[i] = 0.5f;
  volatile float kept_float;
  volatile uint64_t kept_integer;
  double arithmetic = 1e9, clock = 1e9;
  for (int repeat = 0; repeat < REPEATS; ++repeat) {
    double start = now();
    kept_float = chains(factor, term)[0];
    const double middle = now();
    kept_integer = additions(0, static_cast<uint64_t>(argc));
    if (middle - start < arithmetic) arithmetic = middle - start;
    if (now() - middle < clock) clock = now() - middle;
  }
  (void)kept_float, (void)kept_integer;
  std::printf("%g %g %d\n", 2e-9 * STEPS * CHAINS * LANES / arithmetic, 16e-9 * STEPS / clock, LANES);
}
"""


@dataclass(frozen=True)
class Peak:
    """One core: GFLOP/s of single precision (a fused multiply-add counts 2), clock in GHz, lanes of a vector."""

    gflops: float
    clock_ghz: float
    lanes: int


@functools.cache
def measure() -> Peak | None:
    """The peak of one core, in a few seconds; None without a GCC or Clang that can compile for this machine."""
    names = (os.environ.get("CXX", ""), "g++", "clang++", "c++")
    compiler = next((found for name in names if name and (found := shutil.which(name))), "")
    with tempfile.TemporaryDirectory() as folder:
        source, program = Path(folder) / "peak.cpp", Path(folder) / "peak"
        source.write_text(SOURCE)
        for target in (["-march=native"], ["-mcpu=native"], []):
            command = [compiler, "-std=c++17", "-O3", "-ffp-contract=fast", *target, str(source), "-o", str(program)]
            try:
                subprocess.run(command, capture_output=True, check=True)
                printed = subprocess.run([program], capture_output=True, text=True, check=True, timeout=60).stdout
                gflops, clock, lanes = printed.split()
                return Peak(float(gflops), float(clock), int(lanes))
            except (OSError, subprocess.SubprocessError, ValueError):
                continue
    return None


def main() -> None:
    peak = measure()
    if peak is None:
        print("No GCC or Clang here can compile for this machine: the peak is unknown.")
    else:
        print(f"{peak.gflops:.0f} GFLOP/s per core, {peak.clock_ghz:.2f} GHz, {peak.lanes} lanes")


if __name__ == "__main__":
    main()
