"""Which splats each tile draws, nearest first: two stable sorts, by depth and then by tile.

The second sort has keys of 16 bits up to 32,767 tiles (4K), which is a quarter of the passes of one 64-bit sort of
(tile, depth). Its permutation leads from a tile's list back to the order by depth, where the pairs of one Gaussian lie
side by side: that is where the backward pass puts their gradients.
"""

from collections.abc import Sequence

import torch

from ..cuda.launch import THREADS, Device
from ..cuda.sources import kernel
from ..errors import FrogError

TILE = 16  # pixels a side; TILE in src/shared/types.h
_BYTES_A_PAIR = 96  # of lists, the sort's own buffers and gradient slots, at most at a time
_MOST_PAIRS = 2**31 - 2  # positions in a list have 32 bits
MOST_SHORT_TILES = 2**15 - 1  # that a 16-bit key tells apart


def blocks_for(threads: int) -> int:
    """Blocks that hold so many threads."""
    return -(-threads // THREADS)


def tiles_along(pixels: int) -> int:
    """Tiles that hold so many pixels."""
    return -(-pixels // TILE)


def bin_splats(
    launcher: Device, splats: torch.Tensor, depths: torch.Tensor, tile_counts: torch.Tensor, size: Sequence[int]
) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor, torch.Tensor]:
    """The (tile, Gaussian) pairs of an image, M of them; the device is waited for once, for their number.

    Args:
        launcher: of the tensors' device.
        splats: (N, 16) float32, ``Splat`` structs.
        depths: (N,) float32 planar depths; larger than any other where a Gaussian is not drawn.
        tile_counts: (N,) int32 tiles that each splat reaches.
        size: width and height of the image in pixels.

    Returns:
        (M,) int32 Gaussians, tile after tile, nearest first within each; (M,) int64 where each of those lies in the
        order of depth; (tiles + 1,) int32 where each tile's list begins, the last being M; (N,) int64 the first such
        place of each Gaussian that reaches a tile.

    Raises:
        FrogError: the lists would take more than half of the device's memory.
    """
    count, device = len(depths), depths.device
    columns = tiles_along(size[0])
    tiles = columns * tiles_along(size[1])
    order = torch.sort(depths, stable=True).indices
    ends = tile_counts[order].cumsum(0, dtype=torch.int64)
    pairs = int(ends[-1]) if count else 0
    _refuse_too_many(pairs, launcher.memory, size)
    short = tiles <= MOST_SHORT_TILES
    key = torch.int16 if short else torch.int32
    keys = torch.empty(pairs, dtype=key, device=device)
    owners = torch.empty(pairs, dtype=torch.int32, device=device)
    first_slots = torch.empty(count, dtype=torch.int64, device=device)
    emit = kernel("emit", TILE_KEY="short" if short else "int")
    inputs = (count, splats, tile_counts, order, ends, size[0], columns)
    launcher.launch(emit, blocks_for(count) if pairs else 0, *inputs, keys, owners, first_slots)
    ordered, slots = torch.sort(keys, stable=True)
    bounds = torch.arange(tiles + 1, dtype=key, device=device)
    ranges = torch.searchsorted(ordered, bounds, out_int32=True)
    return owners.index_select(0, slots), slots, ranges, first_slots


def _refuse_too_many(pairs: int, memory: int, size: Sequence[int]) -> None:
    needed = pairs * _BYTES_A_PAIR
    if pairs > _MOST_PAIRS or needed > memory // 2:
        lists = f"{pairs:,} overlaps of Gaussians and tiles need about {needed / 2**30:.1f} GiB"
        raise FrogError(
            f"Drawing at {size[0]} x {size[1]}: {lists} of GPU memory, more than half of its {memory / 2**30:.1f} GiB; "
            "expected a smaller image, or fewer or smaller Gaussians."
        )
