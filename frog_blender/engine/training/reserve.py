"""Room on the disk for the scene, kept from the first step on: what fills the disk meanwhile cannot take it."""

from __future__ import annotations

import os
import shutil
import tempfile
from pathlib import Path
from typing import BinaryIO

_MOST = 0.25  # of what is free: a disk that is short already is not filled by this
_BLOCK = 1 << 20


class Reserve:
    """A file without a name beside ``output``, as large as its scene may become; it vanishes with the process.

    Args:
        output: the scene.
        size: bytes, at most a quarter of what the disk has.
    """

    def __init__(self, output: Path, size: int) -> None:
        self._file: BinaryIO | None = None
        try:
            size = min(size, int(_MOST * shutil.disk_usage(output.parent).free))
            self._file = tempfile.TemporaryFile(dir=output.parent, buffering=0)  # noqa: SIM115
            _fill(self._file, size)
        except OSError:  # a disk on which nothing can be kept may have room in the end all the same
            self.give_back()

    def give_back(self) -> bool:
        """Frees the room; False where there is none any more."""
        if self._file is None:
            return False
        self._file.close()
        self._file = None
        return True


def _fill(file: BinaryIO, size: int) -> None:
    """Makes the file so large that its blocks are its own, which a hole would not have."""
    if size <= 0:
        return
    if hasattr(os, "posix_fallocate"):
        os.posix_fallocate(file.fileno(), 0, size)
        return
    for begin in range(0, size, _BLOCK):
        file.write(bytes(min(_BLOCK, size - begin)))
