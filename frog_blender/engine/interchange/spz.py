"""``.spz`` files (nianticlabs/spz): one time's Gaussians, quantized and compressed by gzip. Numpy and zlib alone.

Version 3 is written, versions 2 and 3 are read. Version 4 needs zstd, which Python has only from 3.14 on. Places are
24-bit fixed point, sizes and opacities 8 bits, turns 10 bits a number, colours and harmonics 8 bits; axes are x right,
y up, z back, by the format's definition.

The ``spz`` package was looked at: its wheels are built for some Pythons and platforms alone, and what is left here is
five calls of numpy.
"""

from __future__ import annotations

import math
import struct
import zlib
from pathlib import Path

import numpy as np

from ..arrays import Array
from ..errors import FrogError, found_instead
from ..gaussians import GaussianArrays, NumpyGaussians
from ..io.atomic_files import write_atomically
from ..io.regular_file import regular_file
from ..playback.transform import transform
from .activated import usable
from .usd_source import Y_UP

_MAGIC, _EXPECTED = 0x5053474E, "a .spz file of version 2 or 3"
_HEADER = struct.Struct("<IIIBBBB")
_COLOR = 0.15  # of a harmonic of degree 0 in a colour's 8 bits
_SCALES = 16.0, 10.0  # steps of a logarithm, and how far below zero they begin
_MOST_BITS, _PLACES = 23, 2**23 - 1
_BYTES_OF_BYTE = 1032  # that a byte of a gzip file can become
_HARMONICS = {0: 0, 1: 3, 2: 8, 3: 15}


def write_spz(path: Path, gaussians: NumpyGaussians) -> None:
    """Writes Gaussians with z up, atomically.

    Raises:
        FrogError: when it cannot, and then an earlier file is untouched; or for places beyond the format's range.
    """
    g = transform(gaussians, np.linalg.inv(Y_UP)).checked()
    reach = float(np.abs(g.means).max())
    if not reach < _PLACES:
        raise FrogError(f"{path}: found Gaussians {reach:g} units from the origin, expected less than {_PLACES:,}.")
    bits = min(_MOST_BITS - 1, max(0, _MOST_BITS - math.ceil(math.log2(max(reach, 1e-6) + 1e-6)) - 1))
    fixed = np.rint(g.means.astype(np.float64) * 2**bits).clip(-_PLACES, _PLACES).astype("<i4")
    places = fixed.view(np.uint8).reshape(len(g), 3, 4)[:, :, :3]
    scales = (np.log(np.maximum(g.scales.astype(np.float64), 1e-30)) + _SCALES[1]) * _SCALES[0]
    parts = [
        places.tobytes(),
        _byte(g.opacities * 255).tobytes(),
        _byte((g.sh[:, 0] * _COLOR + 0.5) * 255).tobytes(),
        _byte(scales).tobytes(),
        _smallest_three(g.quaternions).tobytes(),
        _byte(g.sh[:, 1:] * 128 + 128).tobytes(),
    ]
    header = _HEADER.pack(_MAGIC, 3, len(g), g.sh_degree, bits, 0, 0)
    packer = zlib.compressobj(9, zlib.DEFLATED, 31)  # as gzip, without a time or a name
    write_atomically(path, packer.compress(header + b"".join(parts)) + packer.flush())


def read_spz(path: Path) -> tuple[NumpyGaussians, int]:
    """Gaussians with z up, and how many rows are left out that cannot be drawn; FrogError for any other file."""
    content = _unpacked(path, regular_file(path, _EXPECTED).read_bytes())
    magic, version, count, degree, bits, _, _ = _HEADER.unpack_from(content.ljust(_HEADER.size, b"\0"))
    if magic != _MAGIC or version not in (2, 3):
        found = f"version {version}" if magic == _MAGIC else "no .spz file"
        raise found_instead(path, found, _EXPECTED)
    if degree not in _HARMONICS or bits > _MOST_BITS or not count:
        raise found_instead(path, f"{count:,} Gaussians of degree {degree} and {bits} fractional bits", _EXPECTED)
    turn_bytes = 4 if version == 3 else 3
    widths = (9, 1, 3, 3, turn_bytes, 3 * _HARMONICS[degree])
    if len(content) != _HEADER.size + count * sum(widths):
        expected = f"the {_HEADER.size + count * sum(widths):,} of its {count:,} Gaussians"
        raise found_instead(path, f"{len(content):,} bytes", expected)
    columns, start = [], _HEADER.size
    for width in widths:
        columns.append(np.frombuffer(content, np.uint8, count * width, start).reshape(count, width))
        start += count * width
    places, opacities, colors, scales, turns, harmonics = columns
    wide = np.zeros((count, 3, 4), np.uint8)
    wide[:, :, 1:] = places.reshape(count, 3, 3)  # the upper three bytes: the sign is right
    means = (wide.reshape(count, 12).view("<i4") >> 8) / 2.0**bits
    sh = np.concatenate(
        [
            ((colors / 255.0 - 0.5) / _COLOR)[:, None],
            (harmonics.reshape(count, _HARMONICS[degree], 3) - 128.0) / 128.0,
        ],
        axis=1,
    )
    made = GaussianArrays(
        means,
        _from_smallest_three(turns) if version == 3 else _from_three(turns),
        np.exp(scales / _SCALES[0] - _SCALES[1]),
        opacities[:, 0] / 255.0,
        sh,
    )
    gaussians, left_out = usable(path, made, keep_rows=False)
    return transform(gaussians, Y_UP), left_out


def _unpacked(path: Path, content: bytes) -> bytes:
    """What a gzip file holds, with no more memory than its header asks for; other content as it is."""
    if not content.startswith(b"\x1f\x8b"):
        return content
    unpacker = zlib.decompressobj(31)
    try:
        head = unpacker.decompress(content, _HEADER.size)
        if len(head) < _HEADER.size:
            return head
        _, version, count, degree, *_ = _HEADER.unpack(head)
        size = count * (16 + (4 if version == 3 else 3) + 3 * _HARMONICS.get(degree, 0))
        if size > _BYTES_OF_BYTE * len(content):
            raise found_instead(path, f"{len(content):,} bytes for {count:,} Gaussians", _EXPECTED)
        return head + unpacker.decompress(unpacker.unconsumed_tail, size + 1)
    except zlib.error as error:
        raise found_instead(path, f"a file that cannot be unpacked ({error})", _EXPECTED) from error


def _byte(values: Array) -> Array:
    rounded: Array = np.rint(np.nan_to_num(values)).clip(0, 255).astype(np.uint8)
    return rounded


def _smallest_three(quaternions: Array) -> Array:
    """(N,) little-endian uint32: which of x, y, z, w is the largest, and the others in 10 bits each."""
    turns = np.roll(quaternions.astype(np.float64), -1, axis=1)
    turns /= np.maximum(np.linalg.norm(turns, axis=1, keepdims=True), 1e-12)
    largest = np.abs(turns).argmax(axis=1)
    rows = np.arange(len(turns))
    turns *= np.where(turns[rows, largest] < 0, -1.0, 1.0)[:, None]
    packed = largest.astype(np.uint32)
    for axis in range(4):
        size = np.rint(np.abs(turns[:, axis]) * (511 * math.sqrt(2))).clip(0, 511).astype(np.uint32)
        number = (packed << np.uint32(10)) | (np.uint32(512) * (turns[:, axis] < 0)).astype(np.uint32) | size
        packed = np.where(largest == axis, packed, number)
    stored: Array = packed.astype("<u4")
    return stored


def _from_smallest_three(stored: Array) -> Array:
    """(N, 4) w, x, y, z."""
    packed = np.ascontiguousarray(stored).view("<u4")[:, 0]
    largest, turns = (packed >> 30).astype(np.int64), np.zeros((len(packed), 4))
    for axis in range(3, -1, -1):
        here = largest != axis
        number = (packed & 511) / (511 * math.sqrt(2)) * np.where(packed & 512, -1.0, 1.0)
        turns[here, axis] = number[here]
        packed = np.where(here, packed >> 10, packed)
    rest = np.sqrt(np.maximum(1 - np.square(turns).sum(axis=1), 0))
    turns[np.arange(len(turns)), largest] = rest
    return np.roll(turns, 1, axis=1)


def _from_three(stored: Array) -> Array:
    """(N, 4) w, x, y, z of version 2: x, y, z in 8 bits each."""
    xyz = stored / 127.5 - 1
    w = np.sqrt(np.maximum(1 - np.square(xyz).sum(axis=1, keepdims=True), 0))
    return np.concatenate([w, xyz], axis=1)
