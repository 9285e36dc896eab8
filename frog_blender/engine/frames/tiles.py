"""Numbers of images in compressed tiles, so that a part of an image is read without the rest.

A codec compresses each tile, and checks it when it is read. What the numbers mean is the business of ``image_coding``.
"""

from __future__ import annotations

import os
import threading
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import BinaryIO

import numpy as np
from numpy.typing import NDArray

from ..arrays import ImageArray
from .codecs import TileCodec


class DamagedTiles(Exception):
    """What was read is not what was written. Whoever asked knows how to get the image again."""


@dataclass(frozen=True)
class Grid:
    """An image cut into tiles.

    Attributes:
        height, width: of the image.
        side: of a tile; those at the right and lower edge may be smaller.
        channels: bytes a pixel.
    """

    height: int
    width: int
    side: int
    channels: int

    @property
    def lines(self) -> int:
        """Tiles below each other."""
        return -(-self.height // self.side)

    @property
    def columns(self) -> int:
        """Tiles beside each other."""
        return -(-self.width // self.side)

    def count(self) -> int:
        """Tiles."""
        return self.lines * self.columns

    def sizes(self, lines: range, columns: range) -> list[int]:
        """Bytes of tiles, line by line."""
        heights = [min(self.side, self.height - line * self.side) for line in lines]
        widths = [min(self.side, self.width - column * self.side) for column in columns]
        return [height * width * self.channels for height in heights for width in widths]

    def touched(self, rows: slice, columns: slice) -> tuple[range, range]:
        """Lines and columns of the tiles that have any of the pixels."""
        return _tiles(rows, self.side), _tiles(columns, self.side)

    def covered(self, lines: range, columns: range) -> tuple[slice, slice]:
        """Rows and columns of the image that some tiles have."""
        rows = slice(lines.start * self.side, min(lines.stop * self.side, self.height))
        return rows, slice(columns.start * self.side, min(columns.stop * self.side, self.width))


def _tiles(pixels: slice, side: int) -> range:
    return range(pixels.start // side, -(-pixels.stop // side))


class TileFile:
    """Compressed tiles of many images one after the other in a file, read by any number of threads.

    Args:
        path: the file.
        grids: of each image, in the file's order.
        sizes: (tiles,) bytes of all tiles, in the file's order.
        codec: what packed them.

    Raises:
        OSError: if the file cannot be opened.
        DamagedTiles: if the sizes are not those of such images in such a file.
    """

    def __init__(self, path: Path, grids: list[Grid], sizes: NDArray[np.uint32], codec: TileCodec) -> None:
        self.path, self.grids, self._codec = path, grids, codec
        self._first = np.cumsum([0, *(grid.count() for grid in grids)])
        self._offsets = np.concatenate([[0], np.cumsum(sizes, dtype=np.int64)])
        self._lock = threading.Lock()
        self._file: BinaryIO = path.open("rb", buffering=0)
        if len(sizes) != self._first[-1] or os.fstat(self._file.fileno()).st_size != self._offsets[-1]:
            self.close()
            raise DamagedTiles(f"{path}: a length that is not that of its images")

    def close(self) -> None:
        """No image can be read any more."""
        self._file.close()

    def read(self, number: int, lines: range, columns: range) -> ImageArray:
        """The numbers of some tiles of an image, line by line one after the other.

        Raises:
            DamagedTiles: if they cannot be read, or are not what was written.
        """
        grid = self.grids[number]
        sizes, found = iter(grid.sizes(lines, columns)), list[bytes]()
        for line in lines:
            first = int(self._first[number]) + line * grid.columns
            ends = self._offsets[first + columns.start : first + columns.stop + 1].tolist()
            packed = memoryview(self._bytes(ends[0], ends[-1] - ends[0]))
            for start, end in pairwise(ends):
                found.append(self._unpacked(packed[start - ends[0] : end - ends[0]], next(sizes)))
        return np.frombuffer(b"".join(found), np.uint8)

    def _bytes(self, offset: int, size: int) -> bytes:
        """Not by a memory map: the pages of a file that is read are the system's, and count for nobody's memory."""
        try:
            if hasattr(os, "pread"):
                found = os.pread(self._file.fileno(), size, offset)
            else:
                with self._lock:
                    self._file.seek(offset)
                    found = self._file.read(size)
        except (OSError, ValueError) as error:
            raise DamagedTiles(f"{self.path}: {error}") from error
        if len(found) != size:
            raise DamagedTiles(f"{self.path}: {len(found)} bytes of {size} at {offset}")
        return found

    def _unpacked(self, packed: memoryview, size: int) -> bytes:
        try:
            return self._codec.unpack(packed, size)
        except ValueError as error:
            raise DamagedTiles(f"{self.path}: {error}") from error
