"""What lies on the graphics card of each scene: put there once, and of a frame what changes alone.

A texture holds a column's rows one after the other, in as many texels as it takes. A scene's still textures hold all
Gaussians as they are at its beginning; its moving ones hold the rows of the dynamic Gaussians, which come first, at one
time. The card is whatever makes a texture of texels. Nothing here knows Blender.
"""

import math
from collections import OrderedDict
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..engine.errors import FrogError
from ..engine.playback.frame_delta import FrameDelta
from ..engine.playback.player import ScenePlayer
from ..timeline.playback_cache import SceneTime

CHANNELS = {"means": 1, "scales": 1, "quaternions": 4, "base": 4, "sh": 1}
"""Numbers in a texel of each texture. Columns of three numbers take three texels: they are copied as they are."""
_LARGEST = 16_384  # texels of a side that every graphics card of Blender's takes
ROW = 1_024
"""Gaussians in a row of the textures in which all captures lie as a view shows them."""
MOST = _LARGEST * ROW
"""Splats of all captures of a view: 2^24, up to which float32 numbers are exact."""
_ROWS_AT_ONCE = 64  # so that a scene that grows does not make new textures each time
_TIMES_KEPT = 3  # of a scene: duplicates may show others, and playback goes on before the card has drawn


class TooManySplats(FrogError):
    """A viewport shows more splats than can be numbered."""


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
    lacking = size[0] * size[1] * channels - flat.size
    return Texels(size, channels, np.pad(flat, (0, lacking)) if lacking else flat)


def textures_of(columns: Mapping[str, np.ndarray]) -> dict[str, Texels]:
    """The textures of some columns (see ``frame_delta``) by their names; the ``sh_...`` are one."""
    further = sorted((name for name in columns if name.startswith("sh_")), key=lambda name: int(name[3:]))
    together = {name: columns[name] for name in columns if name not in further}
    if further:
        together["sh"] = np.concatenate([columns[name] for name in further], axis=1)
    return {name: texels_of(rows, CHANNELS[name]) for name, rows in together.items()}


def moving_textures(scene: ScenePlayer, part: FrameDelta) -> dict[str, Texels]:
    """The textures of what changes in time, at the time of ``part``.

    Where one coefficient of the colours changes, all of them are there.
    """
    columns = dict(part)
    if any(name.startswith("sh_") for name in columns):
        for name in scene.columns:
            if name.startswith("sh_") and name not in columns:
                columns[name] = scene.column(name, {})[: scene.num_dynamic]
    return textures_of(columns)


def starts_of(counts: Sequence[int]) -> list[int]:
    """The numbers of the captures' first Gaussians: each begins a row.

    Raises:
        TooManySplats: for more Gaussians than can be numbered.
    """
    starts, end = [], 0
    for count in counts:
        starts.append(end)
        end += -(-count // ROW) * ROW
    if end > MOST:
        splats = f"{sum(counts):,} splats in {len(counts):,} captures"
        raise TooManySplats(f"The viewport shows {splats}, expected at most {MOST:,}.")
    return starts


def rows_for(end: int) -> int:
    """The rows of textures for the numbers below ``end``, and some more."""
    rows = -(-end // (ROW * _ROWS_AT_ONCE)) * _ROWS_AT_ONCE
    return min(max(rows, _ROWS_AT_ONCE), _LARGEST)


@dataclass(frozen=True, eq=False)
class Textures:
    """What the shader reads of a scene at one time.

    Attributes:
        still, moving: by the names in ``CHANNELS``; what a scene has nothing of is lacking.
        rows: Gaussians of which ``moving`` has rows.
        sh_count: coefficients of the colours.
    """

    still: dict[str, Any]
    moving: dict[str, Any]
    rows: int
    sh_count: int


class Cloud:
    """One scene on the card."""

    def __init__(self, scene: ScenePlayer, card: Any) -> None:
        self._scene, self._card = scene, card
        self._still = self._uploaded(textures_of({name: scene.column(name, {}) for name in scene.columns}))
        self._moving: OrderedDict[float, dict[str, Any]] = OrderedDict()

    def at(self, shown: SceneTime) -> Textures:
        """The textures at a time; uploads what changes in time, unless that time is there."""
        scene, moving = self._scene, self._moving.pop(shown.time, {})
        if scene.changing:
            self._moving[shown.time] = moving = moving or self._uploaded(moving_textures(scene, shown.part()))
            if len(self._moving) > _TIMES_KEPT:
                self._moving.popitem(last=False)
        return Textures(self._still, moving, scene.num_dynamic, (scene.sh_degree + 1) ** 2)

    def _uploaded(self, textures: dict[str, Texels]) -> dict[str, Any]:
        return {name: self._card.texture(texels) for name, texels in textures.items()}


class Clouds:
    """The scenes on the card, by their tokens."""

    def __init__(self) -> None:
        self._clouds: dict[str, Cloud] = {}

    def of(self, scene: ScenePlayer, card: Any) -> Cloud:
        """A scene's, put there if it is not."""
        if scene.token not in self._clouds:
            self._clouds[scene.token] = Cloud(scene, card)
        return self._clouds[scene.token]

    def keep_only(self, tokens: Iterable[str]) -> None:
        """Drops the others: a file may have been trained anew."""
        kept = set(tokens)
        self._clouds = {token: cloud for token, cloud in self._clouds.items() if token in kept}

    def __len__(self) -> int:
        return len(self._clouds)
