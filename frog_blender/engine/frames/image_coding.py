"""Images as numbers that compress well, without loss, and back.

``native.image_coding`` computes the numbers, tile by tile.

- A plain image: how a pixel differs from its neighbours above and to the left, as far as they are in the tile.
- A detailed image is one of twice the size of another, which is known: how its pixels differ from the one they were
  reduced to. Half-size images, which a training begins with, then cost little beside the whole ones.
"""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from ..arrays import ImageArray
from ..capture.video import load_opencv
from ..native.image_coding import DETAILS, predict, predict_details, restore, restore_details
from .codecs import TileCodec
from .tiles import Grid, TileFile

_SIDE = 128  # pixels of a tile: smaller ones compress less, larger ones cost more where a part is read
_LEAST_HALVED = 64  # pixels a side; smaller images are never reduced

Region = tuple[int, int, int, int]
"""Left, top, width and height in pixels."""


def is_halved(height: int, width: int) -> bool:
    """Whether an image of this size has one of half its size."""
    return min(height, width) >= _LEAST_HALVED


def halved_image(pixels: ImageArray) -> ImageArray:
    """(H // 2, W // 2, 3) means over the area of each pixel, of (H, W, 3); masks (H, W) as well."""
    height, width = pixels.shape[:2]
    cv2 = load_opencv()
    return np.asarray(cv2.resize(pixels, (width // 2, height // 2), interpolation=cv2.INTER_AREA))


def plain_grid(height: int, width: int, channels: int) -> Grid:
    """How a plain image is cut into tiles."""
    return Grid(height, width, _SIDE, channels)


def detail_grid(height: int, width: int) -> Grid:
    """How the details of an image of this size are cut into tiles: four pixels of three channels are one of theirs."""
    return Grid(-(-height // 2), -(-width // 2), _SIDE // 2, DETAILS)


def pack_plain(image: ImageArray, codec: TileCodec) -> list[bytes]:
    """The tiles of a plain image (H, W, 3) or a mask (H, W)."""
    height, width = image.shape[:2]
    grid = plain_grid(height, width, 1 if image.ndim == 2 else 3)
    return _packed(predict(image, grid.side), grid, codec)


def read_plain(file: TileFile, number: int, region: Region | None = None) -> ImageArray:
    """A plain image (H, W, 3), or a mask (H, W), or the region of it.

    Raises:
        DamagedTiles: if it is not what was packed.
    """
    grid = file.grids[number]
    left, top, width, height = region or (0, 0, grid.width, grid.height)
    touched = grid.touched(slice(top, top + height), slice(left, left + width))
    rows, across = grid.covered(*touched)
    x, y = across.start, rows.start
    channels = () if grid.channels == 1 else (grid.channels,)
    image = np.empty((rows.stop - y, across.stop - x, *channels), np.uint8)
    restore(file.read(number, *touched), grid.side, image)
    return image[top - y : top - y + height, left - x : left - x + width]


def pack_details(image: ImageArray, half: ImageArray, codec: TileCodec) -> list[bytes]:
    """The tiles of an image (H, W, 3), given the one (H // 2, W // 2, 3) that it is reduced to."""
    grid = detail_grid(*image.shape[:2])
    even, known = _repeated(image, 2 * grid.height, 2 * grid.width), _repeated(half, grid.height, grid.width)
    return _packed(predict_details(even, known, grid.side), grid, codec)


def read_detailed(details: TileFile, halves: TileFile, number: int, region: Region) -> ImageArray:
    """The region of an image (H, W, 3), given its details and the reduced images.

    Raises:
        DamagedTiles: if it is not what was packed.
    """
    grid, half = details.grids[number], halves.grids[number]
    left, top, width, height = region
    touched = grid.touched(slice(top // 2, -(-(top + height) // 2)), slice(left // 2, -(-(left + width) // 2)))
    rows, across = grid.covered(*touched)
    x, y = across.start, rows.start
    tall, wide = rows.stop - y, across.stop - x
    # The last row and column of an image of odd size have no pixel of their own in the reduced one.
    first = min(x, half.width - 1), min(y, half.height - 1)
    there = (*first, min(x + wide, half.width) - first[0], min(y + tall, half.height) - first[1])
    known = _repeated(read_plain(halves, number, there), tall, wide)
    image = np.empty((2 * tall, 2 * wide, 3), np.uint8)
    restore_details(details.read(number, *touched), known, grid.side, image)
    return image[top - 2 * y : top - 2 * y + height, left - 2 * x : left - 2 * x + width]


def _packed(numbers: ImageArray, grid: Grid, codec: TileCodec) -> list[bytes]:
    """The numbers of an image's tiles, compressed."""
    ends = np.cumsum([0, *grid.sizes(range(grid.lines), range(grid.columns))]).tolist()
    return [codec.pack(numbers.data[first:end]) for first, end in pairwise(ends)]


def _repeated(image: ImageArray, height: int, width: int) -> ImageArray:
    """The image with its last row and column repeated, where there have to be more."""
    missing = height - image.shape[0], width - image.shape[1]
    return np.pad(image, ((0, missing[0]), (0, missing[1]), (0, 0)), mode="edge") if any(missing) else image
