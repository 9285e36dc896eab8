"""Measures how fast this machine's memory is.

    python benchmarks/bandwidth.py

Arrays far larger than the caches are copied by one thread and by one for each core; what is read and what is written
both count (a copy of that size writes past the caches, so nothing is read for writing).
"""

from __future__ import annotations

import functools
import os
import time
from concurrent.futures import ThreadPoolExecutor

import numpy as np

BYTES, REPEATS = 1 << 27, 12


@functools.cache
def measure(threads: int) -> float:
    """Gigabytes (10^9) that ``threads`` threads (0: one for each core) read and write a second, in half a second."""
    threads = threads or os.cpu_count() or 1
    source, target = np.ones(BYTES // 4, np.float32), np.ones(BYTES // 4, np.float32)
    parts = list(zip(np.array_split(source, threads), np.array_split(target, threads), strict=True))
    best = float("inf")
    with ThreadPoolExecutor(threads) as pool:
        for _ in range(REPEATS):
            started = time.perf_counter()
            list(pool.map(lambda part: np.copyto(part[1], part[0]), parts))
            best = min(best, time.perf_counter() - started)
    return 2e-9 * BYTES / best


def main() -> None:
    for threads in sorted({1, os.cpu_count() or 1}):
        print(f"{measure(threads):.1f} GB/s with {threads} threads")


if __name__ == "__main__":
    main()
