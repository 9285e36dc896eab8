"""Disk space reserved for the scene from the first step on, so that whatever fills the disk meanwhile leaves it."""

from __future__ import annotations

import ctypes
import errno
import os
import shutil
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import BinaryIO

_MAX_SHARE = 0.25  # of the free space: a nearly full disk is not filled by this


def allocate(file: BinaryIO, size: int, system: str = sys.platform) -> None:
    """Gives the file blocks of its own, which a hole would not have; OSError where the system cannot at once.

    Not os.posix_fallocate: where the file system cannot, the C library writes into every block, for minutes.
    """
    if size <= 0:
        return
    if system != "linux":
        raise OSError(errno.ENOTSUP, "no space can be reserved at once")
    fallocate = ctypes.CDLL(None, use_errno=True).fallocate
    fallocate.argtypes = [ctypes.c_int, ctypes.c_int, ctypes.c_int64, ctypes.c_int64]
    if fallocate(file.fileno(), 0, 0, size):
        raise OSError(ctypes.get_errno(), "no space can be reserved at once")


class DiskReserve:
    """An unnamed file beside ``output``, as large as its scene may become; it vanishes with the process.

    Nothing is reserved where that would mean writing every byte: outside Linux, and on many network disks.

    Args:
        output: the scene.
        size: bytes, at most a quarter of what the disk has.
        allocate: gives a file so many bytes of the disk; OSError where it cannot at once.
    """

    def __init__(self, output: Path, size: int, allocate: Callable[[BinaryIO, int], None] = allocate) -> None:
        self._file: BinaryIO | None = None
        try:
            size = min(size, int(_MAX_SHARE * shutil.disk_usage(output.parent).free))
            self._file = tempfile.TemporaryFile(dir=output.parent, buffering=0)  # noqa: SIM115
            allocate(self._file, size)
        except OSError:  # a disk on which nothing can be reserved may have space at the end all the same
            self.release()

    @property
    def size(self) -> int:
        """Bytes of the disk that are reserved."""
        return 512 * os.fstat(self._file.fileno()).st_blocks if self._file else 0

    def release(self) -> bool:
        """Frees the space; False where none is reserved any more."""
        if self._file is None:
            return False
        self._file.close()
        self._file = None
        return True
