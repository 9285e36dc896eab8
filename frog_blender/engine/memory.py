"""Giving memory back to the system, and not looking through all of it again and again."""

from __future__ import annotations

import ctypes
import gc
import sys
from collections.abc import Iterator
from contextlib import contextmanager


@contextmanager
def gc_frozen() -> Iterator[None]:
    """Inside the block Python's garbage collector passes over every object that was there before it.

    A training's steps make so many objects that it looks through all of them again and again: torch's, numpy's and
    Blender's are hundreds of thousands, and took 4 % of a step.
    """
    gc.freeze()
    try:
        yield
    finally:
        gc.unfreeze()


def trim_heap() -> None:
    """What was freed goes back to the system, where the C library would keep it (glibc's: half a gigabyte after a few
    trainings in one process, more than they ever hold at once)."""
    if not sys.platform.startswith("linux"):
        return
    trim = getattr(ctypes.CDLL(None), "malloc_trim", None)  # not in every C library
    if trim is not None:
        trim(ctypes.c_size_t(0))
