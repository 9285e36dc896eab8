"""Room on the disk for the scene, kept from the first step on: what fills the disk meanwhile cannot take it."""

from __future__ import annotations

import ctypes
import errno
import shutil
import sys
import tempfile
from pathlib import Path
from typing import BinaryIO

_MOST = 0.25  # of what is free: a disk that is short already is not filled by this


class Reserve:
    """A file without a name beside ``output``, as large as its scene may become; it vanishes with the process.

    There is none where only writing it would fill it: outside Linux, and on many disks in a network.

    Args:
        output: the scene.
        size: bytes, at most a quarter of what the disk has.
    """

    def __init__(self, output: Path, size: int) -> None:
        self._file: BinaryIO | None = None
        try:
            size = min(size, int(_MOST * shutil.disk_usage(output.parent).free))
            self._file = tempfile.TemporaryFile(dir=output.parent, buffering=0)  # noqa: SIM115
            _allocate(self._file, size)
        except OSError:  # a disk on which nothing can be kept may have room in the end all the same
            self.give_back()

    def give_back(self) -> bool:
        """Frees the room; False where there is none any more."""
        if self._file is None:
            return False
        self._file.close()
        self._file = None
        return True


def _allocate(file: BinaryIO, size: int) -> None:
    """Gives the file blocks of its own, which a hole would not have; OSError where the system cannot at once.

    Not os.posix_fallocate: the C library then writes into every block, which takes minutes on a disk in a network.
    """
    if size <= 0:
        return
    if sys.platform != "linux":
        raise OSError(errno.ENOTSUP, "no room can be set aside at once")
    allocate = ctypes.CDLL(None, use_errno=True).fallocate
    allocate.argtypes = [ctypes.c_int, ctypes.c_int, ctypes.c_int64, ctypes.c_int64]
    if allocate(file.fileno(), 0, 0, size):
        raise OSError(ctypes.get_errno(), "no room can be set aside at once")
