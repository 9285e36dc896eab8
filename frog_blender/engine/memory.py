"""Memory returned to the system, and garbage collections that pass over old objects."""

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
    """Returns freed memory to the system, which glibc would keep: half a gigabyte after a few trainings in one process,
    more than they hold at once."""
    if not sys.platform.startswith("linux"):
        return
    trim = getattr(ctypes.CDLL(None), "malloc_trim", None)  # not in every C library
    if trim is not None:
        trim(ctypes.c_size_t(0))
