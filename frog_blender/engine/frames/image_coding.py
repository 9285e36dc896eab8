"""Images as numbers that compress well, without loss, in compressed tiles, so that a part is read without the rest.

``native.image_coding`` computes the numbers, tile by tile: how a pixel differs from its neighbours above and to the
left, as far as they are in the tile. A codec compresses each tile, and checks it when it is read.
"""

import os
import threading
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import BinaryIO

import numpy as np
from numpy.typing import NDArray

from ..arrays import ImageArray
from ..capture.video import load_opencv
from ..native.image_coding import predict, restore
from .codecs import TileCodec

Region = tuple[int, int, int, int]
"""Left, top, width and height in pixels."""
_SIDE = 128  # pixels of a tile: smaller ones compress less, larger ones cost more where a part is read


class DamagedTiles(Exception):
    """What was read is not what was written. Whoever asked knows how to get the image again."""


@dataclass(frozen=True)
class Grid:
    """An image cut into tiles.

    Attributes:
        height, width: of the image.
        channels: bytes a pixel.
    """

    height: int
    width: int
    channels: int

    @property
    def lines(self) -> int:
        """Tiles below each other."""
        return -(-self.height // _SIDE)

    @property
    def columns(self) -> int:
        """Tiles beside each other."""
        return -(-self.width // _SIDE)

    def sizes(self, lines: range, columns: range) -> list[int]:
        """Bytes of tiles, line by line."""
        heights = [min(_SIDE, self.height - line * _SIDE) for line in lines]
        widths = [min(_SIDE, self.width - column * _SIDE) for column in columns]
        return [height * width * self.channels for height in heights for width in widths]


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
        self._first = np.cumsum([0, *(grid.lines * grid.columns for grid in grids)])
        self._offsets = np.concatenate([[0], np.cumsum(sizes, dtype=np.int64)])
        self._lock = threading.Lock()
        self._file: BinaryIO = path.open("rb", buffering=0)
        if len(sizes) != self._first[-1] or os.fstat(self._file.fileno()).st_size != self._offsets[-1]:
            self.close()
            raise DamagedTiles(f"{path}: a length that is not that of its images")

    def close(self) -> None:
        """No image can be read any more."""
        self._file.close()

    def read(self, row: int, lines: range, columns: range) -> ImageArray:
        """The numbers of some tiles of an image, line by line one after the other.

        Raises:
            DamagedTiles: if they cannot be read, or are not what was written.
        """
        grid = self.grids[row]
        sizes, tiles = iter(grid.sizes(lines, columns)), list[bytes]()
        for line in lines:
            first = int(self._first[row]) + line * grid.columns
            ends = self._offsets[first + columns.start : first + columns.stop + 1].tolist()
            packed = memoryview(self._bytes(ends[0], ends[-1] - ends[0]))
            try:
                for start, end in pairwise(ends):
                    tiles.append(self._codec.unpack(packed[start - ends[0] : end - ends[0]], next(sizes)))
            except ValueError as error:
                raise DamagedTiles(f"{self.path}: {error}") from error
        return np.frombuffer(b"".join(tiles), np.uint8)

    def _bytes(self, offset: int, size: int) -> bytes:
        """Not by a memory map: the pages of a file that is read are the system's, and count for nobody's memory."""
        try:
            if hasattr(os, "pread"):
                content = os.pread(self._file.fileno(), size, offset)
            else:
                with self._lock:
                    self._file.seek(offset)
                    content = self._file.read(size)
        except (OSError, ValueError) as error:
            raise DamagedTiles(f"{self.path}: {error}") from error
        if len(content) != size:
            raise DamagedTiles(f"{self.path}: {len(content)} bytes of {size} at {offset}")
        return content


def halved_image(pixels: ImageArray) -> ImageArray:
    """(H // 2, W // 2, 3) means over the area of each pixel, of (H, W, 3); masks (H, W) as well. At least one pixel."""
    height, width = (max(1, side // 2) for side in pixels.shape[:2])
    cv2 = load_opencv()
    return np.asarray(cv2.resize(pixels, (width, height), interpolation=cv2.INTER_AREA))


def pack_image(image: ImageArray, codec: TileCodec) -> list[bytes]:
    """The tiles of an image (H, W, 3) or a mask (H, W)."""
    height, width = image.shape[:2]
    grid = Grid(height, width, 1 if image.ndim == 2 else 3)
    numbers = predict(image, _SIDE)
    ends = np.cumsum([0, *grid.sizes(range(grid.lines), range(grid.columns))]).tolist()
    return [codec.pack(numbers.data[first:end]) for first, end in pairwise(ends)]


def read_image(file: TileFile, row: int, region: Region | None = None) -> ImageArray:
    """An image (H, W, 3), or a mask (H, W), or the region of it.

    Raises:
        DamagedTiles: if it is not what was packed.
    """
    grid = file.grids[row]
    left, top, width, height = region or (0, 0, grid.width, grid.height)
    lines = range(top // _SIDE, -(-(top + height) // _SIDE))  # of the tiles that have any pixel of the region
    columns = range(left // _SIDE, -(-(left + width) // _SIDE))
    x, y = columns.start * _SIDE, lines.start * _SIDE
    size = min(lines.stop * _SIDE, grid.height) - y, min(columns.stop * _SIDE, grid.width) - x
    image = np.empty(size if grid.channels == 1 else (*size, grid.channels), np.uint8)
    restore(file.read(row, lines, columns), _SIDE, image)
    return image[top - y : top - y + height, left - x : left - x + width]
