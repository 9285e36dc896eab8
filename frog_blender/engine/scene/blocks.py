"""Numbers of each Gaussian as whole ones between the least and the largest of their block and column. Numpy alone.

One number far from all others of its block would widen the steps for the 255 others: a Gaussian that a training left at
2e7 would put its neighbours on one place, a huge scale would make theirs all alike. Such numbers stand apart: they are
stored as they are, with where they belong, and the range is that of the others.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..arrays import Array

BLOCK = 256
"""Rows that share a range."""
_TOGETHER = 16 * BLOCK  # rows that are unpacked at once, so that what is in between stays small
APART_BYTES = 8
"""Of a number that stands apart: where it belongs, and its float32."""
_WIDEST = 12.0  # a range in extents of the nearest half of its numbers; of a normal distribution it is 4 of them
# Steps that are fine enough in any block: 2 % of a size, half a degree, a hundredth of an opacity, half a level of 255
# of a colour. Places and embeddings have no such step: theirs is what the scene's other blocks have.
_FINE = {"log_scales": 0.02, "quaternions": 0.004, "opacity_logits": 0.05, "sh": 0.01}


@dataclass(frozen=True)
class Blocks:
    """Quantised columns.

    Attributes:
        least, step: (blocks, columns) float32; level l of a block's column stands for least + l * step.
        levels: (N, columns) whole numbers, uint8 or uint16.
        places: (A,) ascending int64, of the numbers that stand apart among all N * columns.
        numbers: (A,) float32, what they are.
    """

    least: Array
    step: Array
    levels: Array
    places: Array
    numbers: Array


def quantize(name: str, rows: Array, bits: int, *, apart: bool = True) -> Blocks:
    """The finite numbers (N, columns) of an attribute in whole ones of 8 or 16 bits; with ``apart``, those far from all
    others of their block stand apart."""
    kind = np.uint8 if bits == 8 else np.uint16
    inside = _inside(name, rows, bits) if apart else None
    least, step = _ranges(rows, inside, bits)
    block = np.arange(len(rows)) // BLOCK
    with np.errstate(over="ignore"):  # of numbers that stand apart
        levels = np.rint((rows - least[block]) / step[block]).clip(0, 2**bits - 1).astype(kind)
    places = np.empty(0, np.int64) if inside is None else np.flatnonzero(~inside)
    return Blocks(least, step, levels, places, rows.reshape(-1)[places])


def stored(blocks: Blocks) -> bytes:
    """What ``from_stored`` reads: least numbers, steps, levels column by column, and what stands apart."""
    levels = np.ascontiguousarray(blocks.levels.T).reshape(-1)  # columns have most in common
    steps_between = np.diff(blocks.places, prepend=0).astype("<u4")
    ranges = np.stack([blocks.least, blocks.step]).astype("<f4").tobytes()
    parts = (levels, steps_between, blocks.numbers.astype("<f4"))
    return ranges + b"".join(by_significance(part.view(np.uint8), part.itemsize) for part in parts)


def stored_size(rows: int, columns: int, bits: int, apart: int) -> int:
    """Bytes that ``stored`` makes."""
    return 8 * -(-rows // BLOCK) * columns + bits // 8 * rows * columns + APART_BYTES * apart


def from_stored(content: bytes, rows: int, columns: int, bits: int, apart: int) -> Array:
    """(rows, columns) float32 from ``stored_size`` bytes; ValueError for places that are none."""
    blocks = -(-rows // BLOCK)
    ranges = np.frombuffer(content, "<f4", 2 * blocks * columns).reshape(2, blocks, columns)
    middle, end = len(content) - APART_BYTES * apart, len(content) - APART_BYTES // 2 * apart
    kind = np.uint8 if bits == 8 else np.dtype("<u2")
    levels = from_significance(content[ranges.nbytes : middle], bits // 8).view(kind).reshape(columns, rows).T
    found = np.empty((rows, columns), np.float32)
    for begin in range(0, rows, _TOGETHER):
        some = slice(begin, begin + _TOGETHER)
        block = np.arange(begin, min(begin + _TOGETHER, rows)) // BLOCK
        np.multiply(np.ascontiguousarray(levels[some]), ranges[1][block], out=found[some])
        found[some] += ranges[0][block]
    if apart:
        places = from_significance(content[middle:end], 4).view("<u4").cumsum(dtype=np.int64)
        if places[-1] >= rows * columns:
            raise ValueError(f"a number apart at {places[-1]} of {rows * columns}")
        found.reshape(-1)[places] = from_significance(content[end:], 4).view("<f4")
    return found


def by_significance(numbers: Array, width: int) -> bytes:
    """All lowest bytes, then all next ones."""
    return np.ascontiguousarray(numbers.reshape(-1, width).T).tobytes()


def from_significance(content: bytes, width: int) -> Array:
    """The bytes in the order that ``by_significance`` was given."""
    return np.ascontiguousarray(np.frombuffer(content, np.uint8).reshape(width, -1).T).reshape(-1)


def _ranges(rows: Array, inside: Array | None, bits: int) -> tuple[Array, Array]:
    """(blocks, columns) least value and step of what is ``inside``, or of everything."""
    starts = np.arange(0, len(rows), BLOCK)
    if not len(starts):
        return np.empty((0, rows.shape[1]), np.float32), np.empty((0, rows.shape[1]), np.float32)
    low, high = (rows, rows) if inside is None else (np.where(inside, rows, end) for end in (np.inf, -np.inf))
    least, largest = np.minimum.reduceat(low, starts), np.maximum.reduceat(high, starts)
    step = (largest.astype(np.float64) - least) / (2**bits - 1)
    return least.astype(np.float32), np.maximum(step, 1e-30).astype(np.float32)


def _inside(name: str, rows: Array, bits: int) -> Array | None:
    """(N, columns) which numbers stand in their block's range; None where all do."""
    whole = len(rows) // BLOCK * BLOCK
    parts = [part for part in (rows[:whole].reshape(-1, BLOCK, rows.shape[1]), rows[whole:][None]) if part.size]
    by_column = [np.ascontiguousarray(part.transpose(0, 2, 1)) for part in parts]  # (blocks, columns, rows) each
    levels, fine = 2**bits - 1, _FINE.get(name, 0.0)
    suspects = [np.argwhere(np.ptp(part, axis=2) > levels * fine) for part in by_column]
    if not sum(map(len, suspects)):
        return None
    ordered = [np.sort(part[tuple(at.T)], axis=1) for part, at in zip(by_column, suspects, strict=True)]
    extents = [_extent_of_half(part) for part in ordered]
    usual = 0.0 if fine else _usual_extent(extents[0], suspects[0])
    inside = None
    for part, at, values, extent in zip(by_column, suspects, ordered, extents, strict=True):
        widths = np.maximum(_WIDEST * np.maximum(extent, usual), levels * fine)
        for index in np.flatnonzero(np.subtract(values[:, -1], values[:, 0], dtype=np.float64) > widths):
            inside = [np.ones(each.shape, bool) for each in by_column] if inside is None else inside
            mask = inside[0] if part is by_column[0] else inside[-1]
            first, last = _fullest(values[index], widths[index])
            block, column = at[index]
            mask[block, column] = (part[block, column] >= first) & (part[block, column] <= last)
    if inside is None:
        return None
    result: Array = np.concatenate([mask.transpose(0, 2, 1).reshape(-1, rows.shape[1]) for mask in inside])
    return result


def _extent_of_half(ordered: Array) -> Array:
    """(P,) the shortest interval with half of the ascending numbers of each row (P, n), and two of them at least."""
    count = ordered.shape[1]
    half = min(max(-(-count // 2), 2), count)
    result: Array = np.subtract(ordered[:, half - 1 :], ordered[:, : count - half + 1], dtype=np.float64).min(axis=1)
    return result


def _usual_extent(extents: Array, at: Array) -> float:
    """The median over blocks of what the widest of their columns has; of (P,) extents at (block, column) (P, 2)."""
    if not len(extents):
        return 0.0
    _, first = np.unique(at[:, 0], return_index=True)
    return float(np.median(np.maximum.reduceat(extents, first)))


def _fullest(ordered: Array, width: float) -> tuple[float, float]:
    """Ends of the interval of at most that width that holds most of the ascending numbers."""
    after = np.searchsorted(ordered, ordered.astype(np.float64) + width, side="right")
    first = int(np.argmax(after - np.arange(len(ordered))))
    return float(ordered[first]), float(ordered[after[first] - 1])
