"""What lies beside decoded frames where a capture has masks: a byte a pixel of alpha, and one of what is ignored.

A plane in which every image is whole is left out: nothing then costs more than without masks.
"""

from __future__ import annotations

import os
from pathlib import Path
from typing import BinaryIO

import numpy as np

from ..arrays import ImageArray
from .decoding import DecodedShot

_ALPHA, _IGNORED = "alpha.raw", "ignored.raw"
_NONE = ".none"  # the name of an empty file in place of a plane that is left out: the store was not cut off


class MaskPlanes:
    """The planes of a store, memory mapped read-only.

    Args:
        folder: the store's; None for no planes.
    """

    def __init__(self, folder: Path | None = None) -> None:
        self._alpha, self._ignored = (_mapped(folder, name) for name in (_ALPHA, _IGNORED))

    @staticmethod
    def are_whole(folder: Path, pixels: int) -> bool:
        """Whether both planes are there, as far as they are needed, for so many pixels. OSError if one is not."""
        return all(
            (folder / (name + _NONE)).is_file() or (folder / name).stat().st_size == pixels
            for name in (_ALPHA, _IGNORED)
        )

    def alpha(self, offset: int, shape: tuple[int, int]) -> ImageArray | None:
        """(H, W) of the image whose pixels begin at byte ``offset`` of the frames."""
        return _part(self._alpha, offset, shape)

    def ignored(self, offset: int, shape: tuple[int, int]) -> ImageArray | None:
        """(H, W) of the image whose pixels begin at byte ``offset`` of the frames."""
        return _part(self._ignored, offset, shape)


class PlaneWriter:
    """Writes the planes, an image after the other in the order of the frames."""

    def __init__(self, folder: Path) -> None:
        self._planes = [_PlaneFile(folder, _ALPHA, 255), _PlaneFile(folder, _IGNORED, 0)]

    def add(self, shot: DecodedShot) -> None:
        """The next image's."""
        for plane, values in zip(self._planes, (shot.alpha, shot.ignored), strict=True):
            plane.add(values, shot.image.shape[:2])

    def close(self) -> None:
        """Ends the files, and leaves out those that say nothing."""
        for plane in self._planes:
            plane.close()


class _PlaneFile:
    """One plane, made when its first image comes; ``plain`` is what its bytes are where it says nothing."""

    def __init__(self, folder: Path, name: str, plain: int) -> None:
        self._path, self._plain = folder / name, plain
        self._file: BinaryIO | None = None
        self._says_something = False

    def add(self, values: ImageArray | None, shape: tuple[int, ...]) -> None:
        if self._file is None:
            self._file = self._path.open("wb")
        if values is None:
            values = np.full(shape, self._plain, np.uint8)
        self._says_something |= bool((values != self._plain).any())
        self._file.write(np.ascontiguousarray(values).data)

    def close(self) -> None:
        if self._file is None:
            return
        self._file.flush()
        os.fsync(self._file.fileno())
        self._file.close()
        if not self._says_something:
            self._path.unlink()
            self._path.with_name(self._path.name + _NONE).touch()


def _mapped(folder: Path | None, name: str) -> ImageArray | None:
    if folder is None or not (folder / name).is_file():
        return None
    return np.memmap(folder / name, dtype=np.uint8, mode="r")


def _part(plane: ImageArray | None, offset: int, shape: tuple[int, int]) -> ImageArray | None:
    if plane is None:
        return None
    height, width = shape
    return plane[offset // 3 : offset // 3 + height * width].reshape(height, width)
