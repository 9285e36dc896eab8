"""Arrays of a scene as few bytes: quantised in blocks, laid out by significance, compressed by zlib. No torch.

A block is 256 rows in which each column is stored as whole numbers between its least and largest value (see blocks).
Gaussians that lie side by side in the file lie side by side in the scene (see morton_order), or are visible at the same
times (see playback.visibility), so a block spans little and neighbours have bytes in common.
"""

from __future__ import annotations

import math
import zlib
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from ..arrays import Array
from ..io.plain_values import JsonMapping, JsonObject
from . import blocks

_LARGEST = 2**27  # numbers of an unpacked array
_LEVEL = 9
_AS_IT_IS = 1  # bits of a number that is stored as the byte that it is
_LARGEST_HALF = 65_504
# What a scene can need, so that a small file cannot ask for much memory: places of Gaussians hardly compress.
_MEANS_OF_BYTES, _NUMBERS_OF_GAUSSIAN, _LARGEST_NETWORK = 20, 256, 2**22
_ALWAYS, _BYTES_OF_BYTE = 256 << 20, 32  # of all arrays together: so much, and so much for each byte in the file

BITS = {
    "means": 16,
    "log_scales": 8,
    "quaternions": 8,
    "opacity_logits": 8,
    "sh": 8,
    "embeddings": 8,
    "lifetimes": 1,
    "fades": 1,
}
"""Of a number of each Gaussian's attributes; what is not here is stored in half precision, and bytes as they are.

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


def pack(name: str, array: Array, *, outliers_apart: bool = True) -> Packed:
    """A float32 array of any shape, or bytes (uint8); ValueError for numbers that are not finite.

    Args:
        outliers_apart: see ``blocks.quantize``.
    """
    bits, apart = BITS.get(name, 0), 0
    if bits == _AS_IT_IS:
        stored = array.astype(np.uint8).tobytes()
    elif not np.isfinite(array).all():
        raise ValueError(f"{name} holds numbers that are not finite")
    elif not bits:
        if np.abs(array).max(initial=0) > _LARGEST_HALF:
            raise ValueError(f"{name} holds numbers too large for half precision")
        stored = blocks.by_significance(array.astype(np.float16).reshape(-1).view(np.uint8), 2)
    else:
        rows = array.reshape(len(array), math.prod(array.shape[1:]))
        found = blocks.quantize(name, rows, bits, apart=outliers_apart)
        stored, apart = blocks.stored(found), len(found.places)
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
    if type(bits) is not int or bits not in (0, _AS_IT_IS, 8, 16) or (bits and not shape):
        raise ValueError(f"an array of shape {shape} in {bits} bits")
    count = math.prod(shape)
    if count > most or (not count and max(shape, default=0) > most):
        raise ValueError(f"an array of shape {shape}, expected at most {most} numbers")
    apart = description.get("apart", 0)
    if type(apart) is not int or not 0 <= apart <= (count if bits in (8, 16) else 0):
        raise ValueError(f"{apart} numbers apart of {count} in {bits} bits")
    columns = count // shape[0] if bits in (8, 16) and shape[0] else 0
    width = 1 if bits == _AS_IT_IS else 2
    size = blocks.stored_size(shape[0], columns, bits, apart) if columns else width * count
    unpacker = zlib.decompressobj()
    try:
        stored = unpacker.decompress(np.ascontiguousarray(content, np.uint8).tobytes(), size + 1)
    except zlib.error as error:
        raise ValueError(f"damaged bytes ({error})") from error
    if len(stored) != size or not unpacker.eof:
        raise ValueError(f"an array of shape {shape} from other than {size} bytes")
    if bits == _AS_IT_IS:
        return np.frombuffer(stored, np.uint8).reshape(shape)
    if not bits:
        return blocks.from_significance(stored, 2).view(np.float16).astype(np.float32).reshape(shape)
    return blocks.from_stored(stored, shape[0], columns, bits, apart).reshape(shape)


def unpack_scene(arrays: dict[str, Array], descriptions: Mapping[str, JsonMapping]) -> dict[str, Array]:
    """A packed scene's arrays; errors as of ``unpack``, also for arrays that no scene of that size has.

    Args:
        descriptions: of arrays that are all in ``arrays``.
    """
    wanted = sum(4 * math.prod(_shape_of(description)) for description in descriptions.values())
    most = _ALWAYS + _BYTES_OF_BYTE * sum(arrays[name].nbytes for name in descriptions)
    if wanted > most:
        raise ValueError(f"arrays of {wanted:,} bytes, expected at most {most:,}")
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
