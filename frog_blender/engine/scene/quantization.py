"""Arrays of a scene as few bytes: in Morton order, quantized in blocks, laid out by significance, compressed by zlib.

A block is 256 rows in which each column is stored as whole numbers between its least and largest value. Gaussians that
lie side by side in the file lie side by side in the scene, so a block spans little and neighbours have bytes in common.

One number far from all others of its block would widen the steps for the 255 others: a Gaussian that a training left at
2e7 would put its neighbours on one place, a huge scale would make theirs all alike. Such numbers stand apart: they are
stored as they are, with where they belong, and the range is that of the others.
"""

import math
import zlib
from collections.abc import Mapping
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from ..arrays import Array
from ..io.plain_values import JsonMapping, JsonObject
from ..io.unpacking import inflated

BLOCK = 256
"""Rows that share a range."""
_TOGETHER = 16 * BLOCK  # rows that are unpacked at once, so that what is in between stays small
APART_BYTES = 8
"""Of a number that stands apart: where it belongs, and its float32."""
_WIDEST = 12.0  # a range in extents of the nearest half of its numbers; of a normal distribution it is 4 of them
# Steps that are fine enough in any block: 2 % of a size, half a degree, a hundredth of an opacity, half a level of 255
# of a colour. Places and embeddings have no such step: theirs is what the scene's other blocks have.
_FINE = {"log_scales": 0.02, "quaternions": 0.004, "opacity_logits": 0.05, "sh": 0.01}


def stored_blocks(name: str, rows: Array, bits: int) -> tuple[bytes, int]:
    """The finite numbers (N, columns) of an attribute in whole ones of 8 or 16 bits, as ``from_stored`` reads them.

    Least numbers and steps of the blocks, levels column by column, and the numbers that are far from all others of
    their block, with the steps between their places; and how many of those there are.
    """
    inside = _inside(name, rows, bits)
    least, step = _ranges(rows, inside, bits)
    block = np.arange(len(rows)) // BLOCK
    with np.errstate(over="ignore"):  # of numbers that stand apart
        levels = np.rint((rows - least[block]) / step[block]).clip(0, 2**bits - 1).astype(f"<u{bits // 8}")
    places = np.empty(0, np.int64) if inside is None else np.flatnonzero(~inside)
    parts = (
        np.ascontiguousarray(levels.T).reshape(-1),  # columns have most in common
        np.diff(places, prepend=0).astype("<u4"),
        rows.reshape(-1)[places].astype("<f4"),
    )
    ranges = np.stack([least, step]).astype("<f4").tobytes()
    return ranges + b"".join(by_significance(part.view(np.uint8), part.itemsize) for part in parts), len(places)


def stored_size(rows: int, columns: int, bits: int, apart: int) -> int:
    """Bytes that ``stored_blocks`` makes."""
    return 8 * -(-rows // BLOCK) * columns + bits // 8 * rows * columns + APART_BYTES * apart


def from_stored(content: bytes, rows: int, columns: int, bits: int, apart: int) -> Array:
    """(rows, columns) float32 from ``stored_size`` bytes; ValueError for places that are none."""
    blocks = -(-rows // BLOCK)
    ranges = np.frombuffer(content, "<f4", 2 * blocks * columns).reshape(2, blocks, columns)
    middle, end = len(content) - APART_BYTES * apart, len(content) - APART_BYTES // 2 * apart
    kind = np.uint8 if bits == 8 else np.dtype("<u2")
    levels = from_significance(content[ranges.nbytes : middle], bits // 8).view(kind).reshape(columns, rows).T
    result = np.empty((rows, columns), np.float32)
    for begin in range(0, rows, _TOGETHER):
        some = slice(begin, begin + _TOGETHER)
        block = np.arange(begin, min(begin + _TOGETHER, rows)) // BLOCK
        np.multiply(np.ascontiguousarray(levels[some]), ranges[1][block], out=result[some])
        result[some] += ranges[0][block]
    if apart:
        places = from_significance(content[middle:end], 4).view("<u4").cumsum(dtype=np.int64)
        if places[-1] >= rows * columns:
            raise ValueError(f"a number apart at {places[-1]} of {rows * columns}")
        result.reshape(-1)[places] = from_significance(content[end:], 4).view("<f4")
    return result


def by_significance(numbers: Array, width: int) -> bytes:
    """All lowest bytes, then all next ones."""
    return np.ascontiguousarray(numbers.reshape(-1, width).T).tobytes()


def from_significance(content: bytes, width: int) -> Array:
    """The bytes in the order that ``by_significance`` was given."""
    return np.ascontiguousarray(np.frombuffer(content, np.uint8).reshape(width, -1).T).reshape(-1)


def _ranges(rows: Array, inside: Array | None, bits: int) -> tuple[Array, Array]:
    """(blocks, columns) least value and step of what is ``inside``, or of everything."""
    starts = np.arange(0, len(rows), BLOCK)
    low, high = (rows, rows) if inside is None else (np.where(inside, rows, end) for end in (np.inf, -np.inf))
    least, largest = np.minimum.reduceat(low, starts), np.maximum.reduceat(high, starts)
    step = (largest.astype(np.float64) - least) / (2**bits - 1)
    return least.astype(np.float32), np.maximum(step, 1e-30).astype(np.float32)


def _inside(name: str, rows: Array, bits: int) -> Array | None:
    """(N, columns) which numbers stand in their block's range; None where all do."""
    whole = len(rows) // BLOCK * BLOCK
    parts = [part for part in (rows[:whole].reshape(-1, BLOCK, rows.shape[1]), rows[whole:][None]) if part.size]
    by_column = [np.ascontiguousarray(part.transpose(0, 2, 1)) for part in parts]  # (blocks, columns, rows) part_of
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
            inside = [np.ones(part_of.shape, bool) for part_of in by_column] if inside is None else inside
            mask = inside[0] if part is by_column[0] else inside[-1]
            first, last = _fullest(values[index], widths[index])
            block, column = at[index]
            mask[block, column] = (part[block, column] >= first) & (part[block, column] <= last)
    if inside is None:
        return None
    return np.asarray(np.concatenate([mask.transpose(0, 2, 1).reshape(-1, rows.shape[1]) for mask in inside]))


def _extent_of_half(ordered: Array) -> Array:
    """(P,) the shortest interval with half of the ascending numbers of each row (P, n), and two of them at least."""
    count = ordered.shape[1]
    half = min(max(-(-count // 2), 2), count)
    return np.asarray(np.subtract(ordered[:, half - 1 :], ordered[:, : count - half + 1], dtype=np.float64).min(axis=1))


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


_LARGEST = 2**27  # numbers of an unpacked array
_LEVEL = 9
_LARGEST_HALF = 65_504
# What a scene can need, so that a small file cannot ask for much memory: places of Gaussians hardly compress.
_MEANS_OF_BYTES, _NUMBERS_OF_GAUSSIAN, _LARGEST_NETWORK = 20, 256, 2**22
_ALWAYS, _BYTES_OF_BYTE = 128 << 20, 32  # of all arrays together: so much, and so much for each byte in the file

BITS = dict.fromkeys(("log_scales", "quaternions", "opacity_logits", "sh", "embeddings"), 8) | {"means": 16}
"""Of a number of each Gaussian's attributes; what is not here is stored in half precision.

Means have 16: a block's extent in 65,536 parts is a hundredth of a pixel, in 256 parts several pixels. The others
were measured to cost nothing that shows (docs/experiments/compression.md)."""


@dataclass(frozen=True)
class Packed:
    """Attributes:
    content: compressed bytes, as a uint8 array.
    description: plain values that ``unpack`` needs.
    """

    content: Array
    description: JsonObject


def pack(name: str, array: Array) -> Packed:
    """A float32 array of any shape; ValueError for numbers that are not finite."""
    bits, apart = BITS.get(name, 0), 0
    if not np.isfinite(array).all():
        raise ValueError(f"{name} holds numbers that are not finite")
    if not bits:
        if np.abs(array).max(initial=0) > _LARGEST_HALF:
            raise ValueError(f"{name} holds numbers too large for half precision")
        stored = by_significance(array.astype(np.float16).reshape(-1).view(np.uint8), 2)
    else:
        rows = array.reshape(len(array), math.prod(array.shape[1:]))
        stored, apart = stored_blocks(name, rows, bits)
    content = np.frombuffer(zlib.compress(stored, _LEVEL), np.uint8)
    described = {"shape": list(array.shape), "bits": bits} | ({"apart": apart} if apart else {})
    return Packed(content, described)


def unpack(content: Array, description: JsonMapping, most: int = _LARGEST) -> Array:
    """The array as it was, about; KeyError, TypeError or ValueError for what ``pack`` does not write.

    Sizes are checked before anything is allocated.

    Args:
        most: numbers that the array may have.
    """
    shape, bits = _shape_of(description), description["bits"]
    if type(bits) is not int or bits not in (0, 8, 16) or (bits and not shape):
        raise ValueError(f"an array of shape {shape} in {bits} bits")
    count = math.prod(shape)
    if count > most or (not count and max(shape, default=0) > most):
        raise ValueError(f"an array of shape {shape}, expected at most {most} numbers")
    apart = description.get("apart", 0)
    if type(apart) is not int or not 0 <= apart <= (count if bits else 0):
        raise ValueError(f"{apart} numbers apart of {count} in {bits} bits")
    columns = count // shape[0] if bits and shape[0] else 0
    size = stored_size(shape[0], columns, bits, apart) if columns else 2 * count
    stored = inflated(np.ascontiguousarray(content, np.uint8).tobytes(), size, f"an array of shape {shape}")
    if not bits:
        return from_significance(stored, 2).view(np.float16).astype(np.float32).reshape(shape)
    return from_stored(stored, shape[0], columns, bits, apart).reshape(shape)


def unpack_scene(arrays: dict[str, Array], descriptions: Mapping[str, JsonMapping]) -> dict[str, Array]:
    """A packed scene's arrays; errors as of ``unpack``, also for arrays that no scene of that size has.

    Args:
        descriptions: of arrays that are all in ``arrays``.
    """
    size = sum(4 * math.prod(_shape_of(description)) for description in descriptions.values())
    most = _ALWAYS + _BYTES_OF_BYTE * sum(arrays[name].nbytes for name in descriptions)
    if size > most:
        raise ValueError(f"arrays of {size:,} bytes, expected at most {most:,}")
    means = unpack(arrays["means"], descriptions["means"], most=_MEANS_OF_BYTES * arrays["means"].size)
    return {"means": means} | {
        name: unpack(arrays[name], description, _NUMBERS_OF_GAUSSIAN * len(means) if name in BITS else _LARGEST_NETWORK)
        for name, description in descriptions.items()
        if name != "means"
    }


def _shape_of(description: JsonMapping) -> tuple[int, ...]:
    shape = tuple(description["shape"])
    if any(type(length) is not int or length < 0 for length in shape):
        raise ValueError(f"an array of shape {shape}")
    return shape


def morton_order(means: Array) -> Array:
    """(N,) an order of ``means`` (N, 3) in which neighbours follow each other: Morton's curve through them."""
    if not len(means):
        return np.empty(0, np.int64)
    least, largest = np.percentile(means, [1, 99], axis=0)  # a Gaussian far away must not put all others in one cell
    cells = ((means.clip(least, largest) - least) / np.maximum(largest - least, 1e-12) * (2**16 - 1)).astype(np.uint64)
    code = np.zeros(len(means), np.uint64)
    for bit in range(16):
        for axis in range(3):
            code |= ((cells[:, axis] >> np.uint64(bit)) & np.uint64(1)) << np.uint64(3 * bit + axis)
    return np.argsort(code, kind="stable")


def morton_order_by_range(means: Array, *bounds: int) -> Array:
    """(N,) an order of ``means`` (N, 3): the first up to each of the ``bounds``, and the others, each along a curve of
    their own."""
    edges = pairwise((0, *bounds, len(means)))
    return np.concatenate([first + morton_order(means[first:last]) for first, last in edges])
