"""Freed memory goes back to the system, and old objects are not looked through again and again."""

import gc
import sys
import weakref

import pytest
from support.builders import printed, run_python

from frog_blender.engine.memory import gc_frozen

FREE_BUT_THE_LAST = """
import ctypes
from pathlib import Path
from frog_blender.engine import memory

library = ctypes.CDLL(None)
library.malloc.restype, library.malloc.argtypes = ctypes.c_void_p, [ctypes.c_size_t]
library.free.argtypes = [ctypes.c_void_p]


def resident():
    return int(Path("/proc/self/statm").read_text().split()[1])


blocks = []
for _ in range(4000):
    blocks.append(library.malloc(50_000))
    ctypes.memset(blocks[-1], 1, 50_000)
for block in blocks[:-1]:  # the last one holds the end of the heap in its place
    library.free(block)
before = resident()
memory.trim_heap()
print(before, resident())
"""


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="glibc's heap")
def test_what_is_free_goes_back() -> None:
    before, after = (4096 * int(pages) for pages in printed(run_python(FREE_BUT_THE_LAST)).split())
    assert before > 200e6 and after < before - 150e6


class Cycle:
    """Garbage that only the collector finds."""

    def __init__(self) -> None:
        self.me = self


def test_old_objects_are_left_alone_until_the_block_ends_however_it_does() -> None:
    gc.collect()
    gc.disable()
    try:
        old = weakref.ref(Cycle())
        with pytest.raises(ZeroDivisionError), gc_frozen():
            new = weakref.ref(Cycle())
            gc.collect()
            assert old() is not None and new() is None
            1 // 0  # noqa: B018
        assert gc.get_freeze_count() == 0
        gc.collect()
        assert old() is None
    finally:
        gc.enable()
