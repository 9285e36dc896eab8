"""``.spz`` files (nianticlabs/spz): one time's Gaussians, quantized and compressed. Numpy and zlib; zstd for version 4.

Versions 2 to 4 are written and read. 2 and 3 are one gzip stream; 4 is a stream of zstd for each attribute. Places are
24-bit fixed point, sizes and opacities 8 bits, turns 8 bits a number in version 2 and 10 bits from 3 on, colours and
harmonics 8 bits; axes are x right, y up, z back unless an extension says otherwise. Harmonics of degree 4 are left out:
no other format here has them.

The ``spz`` package was looked at: its wheels are built for some Pythons and platforms alone, and what is left here is
a few calls of numpy.
"""

import io
import itertools
import math
import struct
import zlib
from pathlib import Path
from typing import NamedTuple

import numpy as np

from ..arrays import Array, Float64s
from ..errors import brief
from ..gaussians import GaussianArrays, NumpyGaussians
from ..io.plain_values import UnfitValue
from ..io.unpacking import check_growth
from ..playback.transform import transform
from .stills import ANTIALIASED, Y_UP, Part, as_bytes, completed, largest_and_others, units

_MAGIC, EXPECTED = 0x5053474E, "a .spz file of version 2, 3 or 4"
VERSIONS = (2, 3, 4)
"""That can be written: most programs read the first, and fewest the last."""
_HEADER = struct.Struct("<IIIBBBB")
_PLACES_OF_STREAMS = struct.Struct("<I12x")  # after the header in version 4
_SIZES = struct.Struct("<QQ")  # of a stream, packed and unpacked
_ANTIALIASED, _EXTENDED = 1, 2  # flags
_RECORD, _LONGEST_RECORDS, _AXES = struct.Struct("<II"), 1 << 20, 0xADBE0003
_SYSTEMS = [x + y + z for z in "BF" for y in "DU" for x in "LR"] + [x + y + z for y in "FB" for z in "DU" for x in "LR"]
_DIRECTIONS = {"R": (1, 0, 0), "L": (-1, 0, 0), "U": (0, 1, 0), "D": (0, -1, 0), "B": (0, 0, 1), "F": (0, 0, -1)}
_COLOR = 0.15  # of a harmonic of degree 0 in a colour's 8 bits
_SCALES = 16.0, 10.0  # steps of a logarithm, and how far below zero they begin
_MOST_BITS, _PLACES = 23, 2**23 - 1
_SMALLEST_WINDOW = 1 << 23  # bytes, which every decoder of Zstandard has to have
_LEVEL = 12
_HALF_TURNS = np.array([(1, 1, 1, 1), (1, -1, -1, 1), (1, 1, -1, -1), (1, -1, 1, -1)])
_HIGHEST_DEGREE, _MOST_HARMONICS = 4, 15


class Spz(NamedTuple):
    """How to write it.

    Attributes:
        version: one of VERSIONS.
        coarse: half as large, as other programs write: places in 12 bits after the point, harmonics in 5 bits of degree
            1 and 4 of others.
    """

    version: int = VERSIONS[0]
    coarse: bool = False


def spz_bytes(gaussians: NumpyGaussians, as_asked: Spz) -> bytes:
    """A file of Gaussians with z up.

    Raises:
        UnfitValue: for places beyond the format's range.
        ImportError: for version 4 without the package that compresses it.
    """
    version, coarse = as_asked
    g = transform(gaussians, np.linalg.inv(Y_UP))
    reach = float(np.abs(g.means).max())
    if not reach < _PLACES:
        raise UnfitValue(f"Gaussians {reach:g} units from the origin", f"less than {_PLACES:,}")
    steps = np.array([8] * 3 + [16] * 12 if coarse else [1] * 15)[: g.sh.shape[1] - 1, None]
    bits = min(12 if coarse else _MOST_BITS - 1, max(0, _MOST_BITS - math.ceil(math.log2(max(reach, 1e-6) + 1e-6)) - 1))
    fixed = np.rint(g.means.astype(np.float64) * 2**bits).clip(-_PLACES, _PLACES).astype("<i4")
    places = fixed.view(np.uint8).reshape(len(g), 3, 4)[:, :, :3]
    scales = (np.log(np.maximum(g.scales.astype(np.float64), 1e-30)) + _SCALES[1]) * _SCALES[0]
    parts = [
        places.tobytes(),
        as_bytes(g.opacities * 255).tobytes(),
        as_bytes((g.sh[:, 0] * _COLOR + 0.5) * 255).tobytes(),
        as_bytes(scales).tobytes(),
        (_three if version == 2 else _smallest_three)(g.quaternions).tobytes(),
        as_bytes(np.rint(g.sh[:, 1:] * 128 / steps) * steps + 128).tobytes(),
    ]
    count = sum(map(bool, parts)) if version == 4 else 0  # of streams, which version 3 does not count
    header = _HEADER.pack(_MAGIC, version, len(g), g.sh_degree, bits, 0, count)
    if version < 4:
        return zlib.compress(header + b"".join(parts), 9, 31)  # as gzip, without a time or a name
    from zstandard import ZstdCompressor

    streams = [(len(part), ZstdCompressor(level=_LEVEL).compress(part)) for part in parts if part]
    sizes = [_SIZES.pack(len(stream), size) for size, stream in streams]
    head = header + _PLACES_OF_STREAMS.pack(_HEADER.size + _PLACES_OF_STREAMS.size)
    return b"".join([head, *sizes, *(stream for _, stream in streams)])


def decode_spz(_path: Path, content: bytes) -> list[Part]:
    """Gaussians, and from their file's axes to z up; UnfitValue for any other content."""
    unpacker = zlib.decompressobj(31) if content.startswith(b"\x1f\x8b") else None
    head = content if unpacker is None else unpacker.decompress(content, _HEADER.size)
    magic, version, count, degree, bits, flags, streams = _HEADER.unpack_from(head.ljust(_HEADER.size, b"\0"))
    if magic != _MAGIC or version not in (2, 3, 4):
        raise UnfitValue(f"version {version}" if magic == _MAGIC else "no .spz file", EXPECTED)
    if degree > _HIGHEST_DEGREE or bits > _MOST_BITS or not count:
        raise UnfitValue(f"{count:,} Gaussians of degree {degree} and {bits} fractional bits", EXPECTED)
    sizes = [count * width for width in (9, 1, 3, 3, 3 if version == 2 else 4, 3 * ((degree + 1) ** 2 - 1))]
    if version == 4:
        parts, records = _streams(content, sizes, streams)
    else:
        if unpacker is not None:  # no more memory is taken than the header asks for
            check_growth(f"{count:,} Gaussians", len(content), sum(sizes))
            further = _LONGEST_RECORDS if flags & _EXTENDED else 1  # one more shows that there are too many
            content = head + unpacker.decompress(unpacker.unconsumed_tail, sum(sizes) + further)
        ends = [_HEADER.size, *(_HEADER.size + size for size in itertools.accumulate(sizes))]
        if len(content) < ends[-1]:
            raise UnfitValue(f"{len(content):,} bytes", f"the {ends[-1]:,} of its {count:,} Gaussians")
        view = memoryview(content)
        parts, records = [view[start:end] for start, end in itertools.pairwise(ends)], view[ends[-1] :]
        if not flags & _EXTENDED and records:
            raise UnfitValue(f"{len(records):,} bytes more", f"those of its {count:,} Gaussians")
    if flags & ~(_ANTIALIASED | _EXTENDED):
        raise UnfitValue(f"flags {flags:#04x}, whose meaning nobody here knows", EXPECTED)
    columns = [np.frombuffer(part, np.uint8).reshape(count, -1) for part in parts[: 6 if degree else 5]]
    own = _axes(records) if flags & _EXTENDED else np.eye(4)
    notes = (ANTIALIASED,) if flags & _ANTIALIASED else ()
    return [Part(_gaussians(columns, version, bits), Y_UP @ own, notes)]


def _streams(content: bytes, sizes: list[int], count: int) -> tuple[list[memoryview], memoryview]:
    """The attributes of version 4, and the records of extensions before them. No more memory is taken than the
    attributes and a window."""
    import zstandard

    sizes = [size for size in sizes if size]
    start = _PLACES_OF_STREAMS.unpack_from(content.ljust(32, b"\0"), _HEADER.size)[0]
    at = start + count * _SIZES.size
    first = _HEADER.size + _PLACES_OF_STREAMS.size
    if count != len(sizes) or start < first or at > len(content):
        raise UnfitValue(f"{count} streams in {len(content):,} bytes", f"{len(sizes)} of {sum(sizes):,} bytes")
    check_growth("streams", len(content), sum(sizes))
    parts, view = [], memoryview(content)
    for index, size in enumerate(sizes):
        packed, announced = _SIZES.unpack_from(content, start + index * _SIZES.size)
        if announced != size or packed > len(content) - at:
            said = f"a stream of {announced:,} bytes in {packed:,}"
            raise UnfitValue(said, f"{size:,} in at most {len(content) - at:,}")
        unpacker = zstandard.ZstdDecompressor(max_window_size=max(_SMALLEST_WINDOW, 1 << (size - 1).bit_length()))
        try:
            part = unpacker.stream_reader(io.BytesIO(view[at : at + packed])).read(size + 1)
        except zstandard.ZstdError as error:
            raise UnfitValue(f"a stream that cannot be unpacked ({brief(error)})", EXPECTED) from error
        if len(part) != size:
            raise UnfitValue(f"a stream of {len(part):,} bytes at least", f"the {size:,} that are announced")
        parts.append(memoryview(part))
        at += packed
    return parts, view[first:start]


def _axes(records: memoryview) -> Float64s:
    """(4, 4) from a file's own axes, which one of its extensions may name, to x right, y up, z back."""
    at, axes = 0, np.eye(4)
    while at + _RECORD.size <= len(records):
        kind, length = _RECORD.unpack_from(records, at)
        at += _RECORD.size
        if length > len(records) - at:
            raise UnfitValue(f"an extension of {length:,} bytes", f"at most {len(records) - at:,}")
        if kind == _AXES and length == 4:
            system = int.from_bytes(records[at : at + 4], "little")
            if system > len(_SYSTEMS):
                raise UnfitValue(f"axes of number {system}", f"at most {len(_SYSTEMS)}")
            if system:  # 0 says nothing
                axes[:3, :3] = np.array([_DIRECTIONS[letter] for letter in _SYSTEMS[system - 1]]).T
        at += length
    return axes


def _gaussians(columns: list[Array], version: int, bits: int) -> NumpyGaussians:
    """Gaussians of the attributes' bytes, with the file's own axes."""
    places, opacities, colors, scales, turns = columns[:5]
    count = len(places)
    wide = np.zeros((count, 3, 4), np.uint8)
    wide[:, :, 1:] = places.reshape(count, 3, 3)  # the upper three bytes: the sign is right
    means = (wide.reshape(count, 12).view("<i4") >> 8) / 2.0**bits
    sh = ((colors / 255.0 - 0.5) / _COLOR)[:, None]
    if len(columns) > 5:
        further = columns[5].reshape(count, -1, 3)[:, :_MOST_HARMONICS]
        sh = np.concatenate([sh, (further - 128.0) / 128.0], axis=1)
    rotations = _from_three(turns) if version == 2 else _from_smallest_three(turns)
    return GaussianArrays(means, rotations, np.exp(scales / _SCALES[0] - _SCALES[1]), opacities[:, 0] / 255.0, sh)


def _three(quaternions: Array) -> Array:
    """(N, 3) x, y, z in 8 bits each, where w is positive.

    Half a turn about an axis of its own leaves a Gaussian as it is: by one of those, w becomes the largest number. Axes
    are right within a degree then, and within 5 otherwise.
    """
    turns = units(quaternions)
    largest = np.abs(turns).argmax(axis=1)
    turns = np.take_along_axis(turns, largest[:, None] ^ np.arange(4), axis=1) * _HALF_TURNS[largest]
    return as_bytes(np.where(turns[:, :1] < 0, -1, 1) * turns[:, 1:] * 127.5 + 127.5)


def _smallest_three(quaternions: Array) -> Array:
    """(N,) little-endian uint32: which of x, y, z, w is the largest, and the others in 10 bits each."""
    largest, others = largest_and_others(np.roll(quaternions, -1, axis=1))
    sizes = np.rint(np.abs(others) * (511 * math.sqrt(2))).clip(0, 511).astype(np.uint32)
    fields = sizes | (np.uint32(512) * (others < 0)).astype(np.uint32)
    stored = largest.astype(np.uint32) << 30 | fields[:, 0] << 20 | fields[:, 1] << 10 | fields[:, 2]
    return np.asarray(stored, "<u4")


def _from_smallest_three(stored: Array) -> Array:
    """(N, 4) w, x, y, z."""
    packed = np.ascontiguousarray(stored).view("<u4")[:, 0]
    fields = np.stack([packed >> 20, packed >> 10, packed], axis=1)
    others = (fields & 511) / (511 * math.sqrt(2)) * np.where(fields & 512, -1.0, 1.0)
    return np.roll(completed(others, (packed >> 30).astype(np.int64)), 1, axis=1)


def _from_three(stored: Array) -> Array:
    """(N, 4) w, x, y, z of version 2: x, y, z in 8 bits each."""
    xyz = stored / 127.5 - 1
    w = np.sqrt(np.maximum(1 - np.square(xyz).sum(axis=1, keepdims=True), 0))
    return np.concatenate([w, xyz], axis=1)
