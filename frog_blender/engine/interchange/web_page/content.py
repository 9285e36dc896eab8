"""A scene's frames as small integers that a browser unpacks: what ``scene.js`` reads.

Positions keep 16 bits of an inverse hyperbolic sine, fine in the middle of a scene and coarse far out; sizes (as
logarithms), rotations, colours and opacities have 8. What does not change in time is there once. What does is there for
every frame as the difference from the frame before, which ``zlib`` makes small: the smaller since numbers stay as they
are where they would change by one step, or where their Gaussian cannot be seen.
"""

from __future__ import annotations

import zlib
from collections.abc import Generator, Sequence
from dataclasses import dataclass

import numpy as np

from ...arrays import Array
from ...errors import FrogError
from ...gaussians import NumpyGaussians
from ...io.plain_values import JsonObject
from ...playback.frame_delta import WIDTHS, column_names, column_of, column_width
from ..take import Take

MOST_BYTES = 2**29
"""Of a scene's numbers once a browser has unpacked them."""
_SMALLEST_SCALE = 1e-12  # its logarithm is finite
_COLOR_STEPS, _SHAPE_STEPS, _POSITION_STEPS = 255, 127, 8191
_TAIL = 0.0005  # share of a frame's numbers at either end that may be cut off: few, and far from all others
_OPACITY = 3  # column of "base"
_HELD = 1  # steps by which a number may differ before it changes
_UNSEEN = 1  # the largest quantized opacity that is not seen
_STEEPNESS = 8.0  # of a scene's spread: within it positions are about evenly fine


@dataclass(frozen=True)
class Quantizer:
    """Numbers as integers from 0 to ``steps``: ``low + value * (high - low) / steps`` undoes it, up to the curve.

    One byte holds 255 steps, two hold more.

    Attributes:
        curve: "linear", "exp" (the integers are logarithms) or "sinh".
        low, high: (width,) before the curve.
        center, spread: (width,) for "sinh": position = center + spread * sinh(value).
        steps: 255 or more.
    """

    curve: str
    low: Array
    high: Array
    steps: int
    center: Array | None = None
    spread: Array | None = None

    def quantize(self, column: Array) -> Array:
        """Unsigned integers in the shape of ``column`` (..., width)."""
        extent = np.maximum(self.high - self.low, 1e-12)
        values = (self._straight(column.astype(np.float64)) - self.low) / extent
        result: Array = np.rint(values.clip(0, 1) * self.steps).astype(np.uint8 if self.steps < 256 else np.uint16)
        return result

    def _straight(self, column: Array) -> Array:
        straight = column
        if self.curve == "exp":
            straight = np.log(np.maximum(column, _SMALLEST_SCALE))
        elif self.curve == "sinh":
            straight = np.arcsinh((column - self.center) / self.spread)
        return straight

    def to_json(self) -> JsonObject:
        """As ``scene.js`` reads it."""
        values: JsonObject = {"curve": self.curve, "steps": self.steps}
        for name in ("low", "high", "center", "spread"):
            array = getattr(self, name)
            if array is not None:
                values[name] = [float(value) for value in array]
        return values


@dataclass(frozen=True)
class Extent:
    """How far the numbers of a column reach, (width,) each.

    Attributes:
        least, most: all of them.
        low, high: all but a few of them.
    """

    least: Array
    most: Array
    low: Array
    high: Array

    @classmethod
    def of(cls, column: Array) -> Extent:
        """Of a column (N, width) with at least one row."""
        low, high = np.quantile(column.astype(np.float64), (_TAIL, 1 - _TAIL), axis=0)
        return cls(column.min(0).astype(np.float64), column.max(0).astype(np.float64), low, high)

    def joined(self, other: Extent) -> Extent:
        """Of both."""
        least, low = np.minimum(self.least, other.least), np.minimum(self.low, other.low)
        return Extent(least, np.maximum(self.most, other.most), low, np.maximum(self.high, other.high))


@dataclass(frozen=True)
class Survey:
    """What has to be known of all frames before the first can be packed.

    Attributes:
        columns: of the first frame, (N, width) by name.
        changing: names of what changes.
        extents: of all columns, over all frames.
    """

    columns: dict[str, Array]
    changing: tuple[str, ...]
    extents: dict[str, Extent]

    @classmethod
    def of(cls, take: Take) -> Generator[int, None, Survey]:
        """Goes through the frames; yields 0 after each."""
        columns: dict[str, Array] = {}
        extents: dict[str, Extent] = {}
        changing = tuple(take.changing) if take.num_dynamic else ()
        for frame in take.frames():
            gaussians = frame.gaussians
            if not columns:
                names = column_names(gaussians.sh.shape[1])
                _refuse_too_large(take, len(gaussians), names)
                columns = {name: column_of(gaussians, name) for name in names}
                extents = {name: Extent.of(column) for name, column in columns.items()}
            for name in changing:
                extents[name] = extents[name].joined(Extent.of(column_of(gaussians, name, take.num_dynamic)))
            yield 0
        return cls(columns, changing, extents)


class PagePacker:
    """Packs a take's frames one after another.

    Args:
        take: whose frames are added, all of them and in order.
        survey: of the same take.
    """

    def __init__(self, take: Take, survey: Survey) -> None:
        self._moved, self._columns = take.num_dynamic, survey.columns
        self._films: dict[str, list[Array]] = {name: [] for name in survey.changing}
        self._quantizers = {
            name: _quantizer(name, column, survey.extents[name]) for name, column in survey.columns.items()
        }
        self._frames = 0

    def add(self, gaussians: NumpyGaussians) -> None:
        """The next frame."""
        self._frames += 1
        for name, film in self._films.items():
            moved = column_of(gaussians, name, self._moved)
            film.append(self._quantizers[name].quantize(_canonical(name, moved)))

    def packed(self) -> PageContent:
        """All that was added."""
        films = {name: _steady(name, np.stack(film)) for name, film in self._films.items()}
        seen = films["base"][..., _OPACITY] > _UNSEEN if "base" in films else None
        parts: list[bytes] = []
        described: list[JsonObject] = []
        for name, column in self._columns.items():
            quantizer, still = self._quantizers[name], column
            if name in self._films:
                described.append(_add(parts, name, quantizer, _held(name, films[name], seen), film=True))
                still = column[self._moved :]
            if len(still):
                values = quantizer.quantize(_canonical(name, still))
                described.append(_add(parts, name, quantizer, values[None], film=False))
        description: JsonObject = {
            "count": len(self._columns["means"]),
            "dynamic": self._moved,
            "sh_count": len(self._columns) - len(WIDTHS) + 1,
            "frames": self._frames,
            "arrays": described,
        }
        return PageContent(description, b"".join(parts))


@dataclass(frozen=True)
class PageContent:
    """Attributes:
    description: of ``data``, plain values for JSON.
    data: compressed arrays, one after another.
    """

    description: JsonObject
    data: bytes


def _refuse_too_large(take: Take, count: int, names: Sequence[str]) -> None:
    frames = len(take.numbers)
    needed = 4 * count * sum(column_width(name) for name in names)
    needed += 2 * frames * take.num_dynamic * sum(column_width(name) for name in take.changing)
    if needed > MOST_BYTES:
        raise FrogError(
            f"A page of {frames} frames would unpack to {needed / 1e6:,.0f} MB in the browser, expected at most "
            f"{MOST_BYTES / 1e6:,.0f} MB; export fewer frames."
        )


def _quantizer(name: str, column: Array, extent: Extent) -> Quantizer:
    """For a column (N, width) of the first frame, and how far it reaches in all."""
    width = column.shape[1]
    if name == "quaternions":
        return Quantizer("linear", np.full(4, -1.0), np.full(4, 1.0), _SHAPE_STEPS)
    if name == "scales":
        low, high = (np.log(np.maximum(bound, _SMALLEST_SCALE)) for bound in (extent.low.min(), extent.most.max()))
        return Quantizer("exp", np.full(width, low), np.full(width, high), _SHAPE_STEPS)
    if name == "means":
        center = np.median(column.astype(np.float64), axis=0)
        spread = np.maximum(np.median(np.abs(column - center), axis=0) * _STEEPNESS, 1e-9)
        low, high = (np.arcsinh((bound - center) / spread) for bound in (extent.least, extent.most))
        return Quantizer("sinh", low, high, _POSITION_STEPS, center, spread)
    low, high = extent.low.copy(), extent.high.copy()
    if name == "base":
        low[3], high[3] = 0.0, 1.0
    return Quantizer("linear", low, high, _COLOR_STEPS)


def _canonical(name: str, column: Array) -> Array:
    """Unit quaternions with w >= 0; anything else as it is."""
    if name != "quaternions":
        return column
    unit = column / np.maximum(np.linalg.norm(column, axis=1, keepdims=True), 1e-12)
    result: Array = np.where(unit[:, :1] < 0, -unit, unit)
    return result


def _steady(name: str, film: Array) -> Array:
    """(T, M, width) quantised frames, of which no quaternion jumps to the other of its two signs."""
    if name != "quaternions":
        return film
    film = film.copy()
    for frame in range(1, len(film)):
        before, now = (
            film[frame - 1].astype(np.int32) * 2 - _SHAPE_STEPS,
            film[frame].astype(np.int32) * 2 - _SHAPE_STEPS,
        )
        flipped = (before * now).sum(1) < 0
        film[frame][flipped] = _SHAPE_STEPS - film[frame][flipped]
    return film


def _held(name: str, film: Array, seen: Array | None) -> Array:
    """(T, M, width) quantised frames whose numbers change only by more than _HELD steps and where they are seen.

    Args:
        seen: (T, M) where a Gaussian is; None for everywhere. Before that its numbers are those with which it appears.
    """
    shown = np.ones(film.shape, bool)
    if seen is not None:
        shown &= seen[..., None]
    if name == "base":
        shown[..., _OPACITY] = True
    first = np.argmax(shown, axis=0)
    now = np.take_along_axis(film, first[None], axis=0)[0]
    result = np.empty_like(film)
    for frame, values in enumerate(film):
        change = np.abs(values.astype(np.int32) - now) > _HELD
        now = np.where(change & shown[frame], values, now)
        result[frame] = now
    return result


def _add(parts: list[bytes], name: str, quantizer: Quantizer, values: Array, *, film: bool) -> JsonObject:
    """Appends (T, M, width) integers: number by number of a Gaussian, frame by frame, low bytes before high bytes."""
    ordered = np.ascontiguousarray(values.transpose(2, 0, 1))
    if film:
        ordered[:, 1:] -= ordered[:, :-1].copy()  # unsigned: wraps round, and back in the browser
    planes = [ordered.astype(np.uint8)]
    if quantizer.steps > 255:
        planes.append((ordered >> 8).astype(np.uint8))
    content = zlib.compress(b"".join(plane.tobytes() for plane in planes), 9)
    parts.append(content)
    described: JsonObject = {"name": name, "film": film, "rows": values.shape[1], "width": values.shape[2]}
    return {**described, "bytes": len(content), **quantizer.to_json()}
