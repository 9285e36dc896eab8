"""Giving memory back to the system."""

from __future__ import annotations

import ctypes
import sys


def give_back() -> None:
    """What was freed goes back to the system, where the C library would keep it (glibc's: half a gigabyte after a few
    trainings in one process, more than they ever hold at once)."""
    if not sys.platform.startswith("linux"):
        return
    trim = getattr(ctypes.CDLL(None), "malloc_trim", None)  # not in every C library
    if trim is not None:
        trim(ctypes.c_size_t(0))
