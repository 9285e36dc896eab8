"""How the columns of Gaussians lie in textures: which are there for good, and which a frame replaces.

A texture holds a column's rows one after the other, in as many texels as it takes. A scene's still textures hold all
Gaussians as they are at its beginning; its moving ones hold the rows of the dynamic Gaussians, which come first, at one
time. Nothing here knows Blender.
"""

from __future__ import annotations

import math
from collections.abc import Hashable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from ..engine.errors import FrogError

if TYPE_CHECKING:
    from ..engine.playback.frame_delta import FrameDelta
    from ..engine.playback.player import ScenePlayer

CHANNELS = {"means": 1, "scales": 1, "quaternions": 4, "base": 4, "sh": 1}
"""Numbers in a texel of each texture. Columns of three numbers take three texels: they are copied as they are."""
_LARGEST = 16_384  # texels of a side that every graphics card of Blender's takes
ROW = 1_024
"""Gaussians in a row of the textures in which all captures lie as a view shows them."""
MOST = _LARGEST * ROW
"""Splats of all captures of a view: 2^24, up to which float32 numbers are exact."""
_ROWS_AT_ONCE = 64  # so that a scene that grows does not make new textures each time


@dataclass(frozen=True)
class Texels:
    """The content of a texture.

    Attributes:
        size: width and height.
        channels: numbers in a texel, 1 or 4.
        values: (width * height * channels,) float32, filled up with zeros.
    """

    size: tuple[int, int]
    channels: int
    values: np.ndarray

    @property
    def bytes(self) -> int:
        """What goes to the card."""
        return int(self.values.nbytes)


def texture_size(texels: int) -> tuple[int, int]:
    """Width, a power of two, and height of a texture with at least so many texels, nearly square.

    Raises:
        ValueError: if no graphics card holds them.
    """
    width = 1 << max(0, math.ceil(math.log2(max(1, texels)) / 2))
    height = max(1, -(-texels // width))
    if max(width, height) > _LARGEST:
        raise ValueError(f"{texels:,} numbers are too many for a texture, expected at most {_LARGEST**2:,}")
    return width, height


def texels_of(rows: np.ndarray, channels: int) -> Texels:
    """The texture of an array of rows."""
    flat = np.ascontiguousarray(rows, np.float32).reshape(-1)
    size = texture_size(-(-flat.size // channels))
    values = flat
    if (lacking := size[0] * size[1] * channels - flat.size) > 0:
        values = np.concatenate([flat, np.zeros(lacking, np.float32)])
    return Texels(size, channels, values)


def textures_of(columns: Mapping[str, np.ndarray]) -> dict[str, Texels]:
    """The textures of some columns (see ``frame_delta``) by their names; the ``sh_...`` are one."""
    further = sorted((name for name in columns if name.startswith("sh_")), key=lambda name: int(name[3:]))
    together = {name: columns[name] for name in columns if name not in further}
    if further:
        together["sh"] = np.concatenate([columns[name] for name in further], axis=1)
    return {name: texels_of(rows, CHANNELS[name]) for name, rows in together.items()}


def still_textures(scene: ScenePlayer) -> dict[str, Texels]:
    """The textures of all Gaussians of a scene at its beginning."""
    from ..engine.playback.frame_delta import FrameDelta

    return textures_of({name: scene.column(name, FrameDelta({})) for name in scene.columns})


def moving_textures(scene: ScenePlayer, part: FrameDelta) -> dict[str, Texels]:
    """The textures of what changes in time, at the time of ``part``.

    Where one coefficient of the colours changes, all of them are there.
    """
    columns = dict(part.columns)
    if any(name.startswith("sh_") for name in columns):
        from ..engine.playback.frame_delta import FrameDelta

        for name in scene.columns:
            if name.startswith("sh_") and name not in columns:
                columns[name] = scene.column(name, FrameDelta({}))[: scene.num_dynamic]
    return textures_of(columns)


def starts_of(counts: Sequence[int]) -> list[int]:
    """The numbers of the captures' first Gaussians: each begins a row.

    Raises:
        FrogError: for more Gaussians than can be numbered.
    """
    starts, end = [], 0
    for count in counts:
        starts.append(end)
        end += _whole_rows(count)
    if end > MOST:
        found = f"{sum(counts):,} splats in {len(counts):,} captures"
        raise FrogError(f"The viewport shows {found}, expected at most {MOST:,}. Hide some captures.")
    return starts


def too_many(counts: Sequence[tuple[Hashable, int]], others: Sequence[int] = ()) -> frozenset[Hashable]:
    """Who has to be left out, so that ``starts_of`` can number the rest: whoever does not fit beside those before.

    Args:
        counts: of Gaussians and whose they are; whoever has several is drawn wholly or not at all.
        others: counts that are not left out.
    """
    wanted: dict[Hashable, int] = {}
    for owner, count in counts:
        wanted[owner] = wanted.get(owner, 0) + _whole_rows(count)
    left, room = set(), MOST - sum(_whole_rows(count) for count in others)
    for owner, some in wanted.items():
        if some > room:
            left.add(owner)
        else:
            room -= some
    return frozenset(left)


def _whole_rows(count: int) -> int:
    return -(-count // ROW) * ROW


def rows_for(end: int) -> int:
    """The rows of textures for the numbers below ``end``, and some more."""
    rows = -(-end // (ROW * _ROWS_AT_ONCE)) * _ROWS_AT_ONCE
    return min(max(rows, _ROWS_AT_ONCE), _LARGEST)
