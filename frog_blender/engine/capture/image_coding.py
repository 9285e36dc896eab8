"""Images as numbers that compress well, without loss, and back.

Of a pixel its green is kept and how much red and blue differ from it. All arithmetic is modulo 256, so that nothing
overflows and every image comes back to the bit.

- A plain image: how a pixel differs from its neighbours above and to the left, as far as they are in the tile.
- A detailed image is one of twice the size of another, which is known: how its pixels differ from the one they were
  reduced to. Half-size images, which a training begins with, then cost little beside the whole ones.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ..arrays import ImageArray
from .image_tiles import Grid, TileFile, compressor
from .video import load_opencv

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
    return Grid(-(-height // 2), -(-width // 2), _SIDE // 2, 12)


def pack_plain(image: ImageArray) -> list[bytes]:
    """The tiles of a plain image (H, W, 3) or a mask (H, W)."""
    planes = _planes(image)
    channels, height, width = planes.shape
    below = planes.copy()
    below[:, 1:] -= planes[:, :-1]
    below[:, ::_SIDE] = planes[:, ::_SIDE]
    columns = _transposed(below.reshape(channels * height, width))
    beside = columns.copy()
    beside[1:] -= columns[:-1]
    beside[::_SIDE] = columns[::_SIDE]
    differences, pack = beside.reshape(width, channels, height), compressor()
    places = plain_grid(height, width, channels).tiles()
    return [pack.compress(np.ascontiguousarray(differences[across, :, rows])) for rows, across in places]


def read_plain(file: TileFile, number: int, region: Region | None = None) -> ImageArray:
    """A plain image (H, W, 3), or a mask (H, W), or the region of it.

    Raises:
        DamagedTiles: if it is not what was packed.
    """
    grid = file.grids[number]
    rows, across = _pixels(region or (0, 0, grid.width, grid.height))
    touched = grid.touched(rows, across)
    all_rows, all_across = grid.covered(*touched)
    x, y = all_across.start, all_rows.start
    differences = np.empty((all_across.stop - x, grid.channels, all_rows.stop - y), np.uint8)
    for there, beside, numbers in file.read(number, *touched):
        part = differences[beside.start - x : beside.stop - x, :, there.start - y : there.stop - y]
        part[...] = numbers.reshape(part.shape)
    image = _summed(differences)
    return image[rows.start - y : rows.stop - y, across.start - x : across.stop - x]


def pack_details(image: ImageArray, half: ImageArray) -> list[bytes]:
    """The tiles of an image (H, W, 3), given the one (H // 2, W // 2, 3) that it is reduced to."""
    height, width = image.shape[:2]
    even = _upper(image, height + height % 2, width + width % 2)
    tall, wide = even.shape[0] // 2, even.shape[1] // 2
    quarters = np.empty((4, 3, tall, wide), np.uint8)
    for line in (0, 1):  # two neighbours of a row are six channels of one pixel
        pair = load_opencv().split(np.ascontiguousarray(even[line::2]).reshape(tall, wide, 6))
        for side in (0, 1):
            _take_green(pair[3 * side : 3 * side + 3], quarters[2 * line + side])
    quarters -= _planes(_upper(half, tall, wide))
    # Their sum is nearly 0, as ``half`` is their mean: that says more than the last one does.
    for quarter in quarters[:3]:
        quarters[3] += quarter
    numbers, pack = quarters.reshape(12, tall, wide), compressor()
    places = detail_grid(height, width).tiles()
    return [pack.compress(np.ascontiguousarray(numbers[:, rows, across])) for rows, across in places]


def read_detailed(details: TileFile, halves: TileFile, number: int, region: Region) -> ImageArray:
    """The region of an image (H, W, 3), given its details and the reduced images.

    Raises:
        DamagedTiles: if it is not what was packed.
    """
    grid, half = details.grids[number], halves.grids[number]
    left, top, width, height = region
    rows, across = slice(top // 2, -(-(top + height) // 2)), slice(left // 2, -(-(left + width) // 2))
    touched = grid.touched(rows, across)
    rows, across = grid.covered(*touched)
    x, y = across.start, rows.start
    tall, wide = rows.stop - y, across.stop - x
    # The last row and column of an image of odd size have no pixel of their own in the reduced one.
    first = min(x, half.width - 1), min(y, half.height - 1)
    known = (*first, min(x + wide, half.width) - first[0], min(y + tall, half.height) - first[1])
    base = _planes(_upper(read_plain(halves, number, known), tall, wide))
    image = np.empty((tall, 2, wide, 6), np.uint8)  # two neighbours of a row are six channels of one pixel
    merge = load_opencv().merge
    for there, beside, found in details.read(number, *touched):
        place = slice(there.start - y, there.stop - y), slice(beside.start - x, beside.stop - x)
        known_here = np.ascontiguousarray(base[:, place[0], place[1]])
        quarters = found.reshape(4, *known_here.shape).copy()
        quarters[3] -= quarters[:3].sum(axis=0, dtype=np.uint8)
        quarters += known_here
        quarters[:, 1:] += quarters[:, :1]
        for line in (0, 1):
            pair = [quarters[2 * line + side, channel] for side in (0, 1) for channel in (1, 0, 2)]
            image[place[0], line, place[1]] = np.asarray(merge(pair)).reshape(*known_here.shape[1:], 6)
    whole: ImageArray = image.reshape(2 * tall, 2 * wide, 3)
    return whole[top - 2 * y : top - 2 * y + height, left - 2 * x : left - 2 * x + width]


def _pixels(region: Region) -> tuple[slice, slice]:
    left, top, width, height = region
    return slice(top, top + height), slice(left, left + width)


def _upper(half: ImageArray, height: int, width: int) -> ImageArray:
    """The image with its last row and column repeated, where there have to be more."""
    missing = height - half.shape[0], width - half.shape[1]
    return np.pad(half, ((0, missing[0]), (0, missing[1]), (0, 0)), mode="edge") if any(missing) else half


def _planes(image: ImageArray) -> ImageArray:
    """(channels, H, W): green, red less green and blue less green; a mask is one plane."""
    if image.ndim == 2:
        return np.ascontiguousarray(image)[None]
    planes = np.empty((3, *image.shape[:2]), np.uint8)
    _take_green(load_opencv().split(np.ascontiguousarray(image)), planes)
    return planes


def _take_green(channels: Sequence[ImageArray], planes: ImageArray) -> None:
    """Fills planes (3, H, W) with green, red less green and blue less green, of red, green and blue (H, W)."""
    red, green, blue = channels
    planes[0] = green
    np.subtract(red, green, out=planes[1])
    np.subtract(blue, green, out=planes[2])


def _summed(differences: ImageArray) -> ImageArray:
    """The plain image (H, W, 3) or (H, W) of differences (W, channels, H), in which tiles begin at multiples of
    ``_SIDE``."""
    width, channels, height = differences.shape
    lines = differences.reshape(width, channels * height)
    for place in range(1, min(_SIDE, width)):
        ours = lines[place::_SIDE]
        ours += lines[place - 1 :: _SIDE][: len(ours)]
    planes = _transposed(lines).reshape(channels, height, width)
    for place in range(1, min(_SIDE, height)):
        ours = planes[:, place::_SIDE]
        ours += planes[:, place - 1 :: _SIDE][:, : ours.shape[1]]
    if channels == 1:
        mask: ImageArray = planes[0]
        return mask
    green, red, blue = planes
    red += green
    blue += green
    return np.asarray(load_opencv().merge([red, green, blue]))


def _transposed(matrix: ImageArray) -> ImageArray:
    """(W, H) contiguous of (H, W): OpenCV's is several times as fast as numpy's."""
    turned: ImageArray = load_opencv().transpose(matrix)
    return turned.reshape(matrix.shape[1], matrix.shape[0])
