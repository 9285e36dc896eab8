"""``.ksplat`` files (mkkellogg/GaussianSplats3D): sections of Gaussians, in floats or about the centres of buckets.

No file says which way is up. Numpy alone.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ..arrays import Array
from ..errors import found_instead
from ..gaussians import GaussianArrays, NumpyGaussians, joined
from ..io.plain_values import UnfitValue
from ..io.regular_file import regular_file
from ..spherical_harmonics import SH_DC
from .activated import usable

_EXPECTED = "a .ksplat file of version 0.1"
_MAIN, _SECTION = 4096, 1024  # bytes of the headers
_HARMONICS = (0, 9, 24)  # numbers of degree 0, 1 and 2
_RANGES = {1: slice(0, 3), 2: slice(3, 8)}  # coefficients of a degree, after the first
_COMMON_RANGE = 32767
_LEAST_HARMONIC = 1.5


@dataclass(frozen=True)
class _Section:
    """Attributes:
    count, capacity: Gaussians that it has, and has room for.
    bucket_capacity, buckets, full, partial: how many Gaussians share a centre, and how many centres there are.
    block, step_range: extent of a bucket, and steps from its centre to its side.
    bucket_bytes, degree: of a centre, and of the harmonics.
    """

    count: int
    capacity: int
    bucket_capacity: int
    buckets: int
    block: float
    bucket_bytes: int
    step_range: int
    full: int
    partial: int
    degree: int


def read_ksplat(path: Path) -> tuple[NumpyGaussians, int]:
    """Gaussians with the file's own axes, and how many rows are left out; FrogError for any other file."""
    content = regular_file(path, _EXPECTED).read_bytes()
    try:
        with np.errstate(invalid="ignore", over="ignore"):  # numbers that are none are left out afterwards
            made = _gaussians(content)
    except UnfitValue as error:
        raise found_instead(path, error.found, error.expected) from error
    return usable(path, made, keep_rows=False)


def _gaussians(content: bytes) -> NumpyGaussians:
    if len(content) < _MAIN or content[0] != 0 or content[1] < 1:
        raise UnfitValue("no such header", _EXPECTED)
    (sections,) = struct.unpack_from("<I", content, 4)
    (level,) = struct.unpack_from("<H", content, 20)
    low, high = struct.unpack_from("<2f", content, 36)
    if level > 2 or not 1 <= sections <= len(content) // _SECTION:
        raise UnfitValue(f"{sections:,} sections of compression {level}", _EXPECTED)
    bounds = low or -_LEAST_HARMONIC, high or _LEAST_HARMONIC
    start = _MAIN + sections * _SECTION
    parts = []
    for place in range(sections):
        section = _section(content, _MAIN + place * _SECTION)
        found, start = _read_section(content, start, section, level, bounds)
        if len(found):
            parts.append(found)
    if not parts:
        raise UnfitValue("no Gaussians", _EXPECTED)
    return joined(parts)


def _section(content: bytes, at: int) -> _Section:
    if at + _SECTION > len(content):
        raise UnfitValue(f"{len(content):,} bytes", "room for the sections' headers")
    count, capacity, bucket_capacity, buckets = struct.unpack_from("<4I", content, at)
    (block,) = struct.unpack_from("<f", content, at + 16)
    (bucket_bytes,) = struct.unpack_from("<H", content, at + 20)
    (step_range,) = struct.unpack_from("<I", content, at + 24)
    full, partial = struct.unpack_from("<2I", content, at + 32)
    (degree,) = struct.unpack_from("<H", content, at + 40)
    if count > capacity or degree >= len(_HARMONICS):
        raise UnfitValue(f"{count:,} Gaussians of degree {degree} in a section for {capacity:,}", _EXPECTED)
    found = count, capacity, bucket_capacity, buckets, block, bucket_bytes, step_range or _COMMON_RANGE
    return _Section(*found, full, partial, degree)


def _read_section(
    content: bytes, start: int, section: _Section, level: int, bounds: tuple[float, float]
) -> tuple[NumpyGaussians, int]:
    """The Gaussians of a section, and where the next one begins."""
    number = "<f4" if level == 0 else "<f2"
    further = _HARMONICS[section.degree]
    row = np.dtype(
        [
            ("mean", "<f4" if level == 0 else "<u2", 3),
            ("scale", number, 3),
            ("turn", number, 4),
            ("rgba", "u1", 4),
            ("sh", {0: "<f4", 1: "<f2", 2: "u1"}[level], (further,)),
        ]
    )
    first = start + 4 * section.partial + section.bucket_bytes * section.buckets
    end = first + row.itemsize * section.capacity
    if end > len(content):
        raise UnfitValue(f"{len(content):,} bytes", f"the {end:,} that the headers announce")
    table = np.frombuffer(content, row, section.count, first)
    means = table["mean"].astype(np.float64)
    if level and section.count:
        centres = _centres(content, start, section)
        means = (means - section.step_range) * (section.block / 2 / section.step_range) + centres
    colors = ((table["rgba"][:, :3] / 255.0 - 0.5) / SH_DC)[:, None]
    harmonics = table["sh"].astype(np.float64)
    if level == 2:
        harmonics = bounds[0] + harmonics / 255 * (bounds[1] - bounds[0])
    sh = [colors]
    begin = 0
    for degree in range(1, section.degree + 1):  # of each degree all of red, then green, then blue
        width = _RANGES[degree].stop - _RANGES[degree].start
        sh.append(harmonics[:, begin : begin + 3 * width].reshape(-1, 3, width).transpose(0, 2, 1))
        begin += 3 * width
    opacities = table["rgba"][:, 3] / 255.0
    return GaussianArrays(means, table["turn"], table["scale"], opacities, np.concatenate(sh, axis=1)), end


def _centres(content: bytes, start: int, section: _Section) -> Array:
    """(N, 3) the centre of each Gaussian's bucket: the full ones come first."""
    if section.bucket_bytes != 12 or not np.isfinite(section.block) or section.full + section.partial > section.buckets:
        raise UnfitValue("buckets that cannot be", _EXPECTED)
    sizes = np.frombuffer(content, "<u4", section.partial, start).astype(np.int64)
    in_full = section.full * section.bucket_capacity
    rest = section.count - min(in_full, section.count)
    if sizes.sum() < rest:
        raise UnfitValue(f"buckets for {in_full + int(sizes.sum()):,} Gaussians", f"for {section.count:,}")
    bucket = np.arange(section.count - rest) // max(section.bucket_capacity, 1)
    ends = np.cumsum(sizes)
    bucket = np.concatenate([bucket, section.full + np.searchsorted(ends, np.arange(rest), "right")])
    centres = np.frombuffer(content, "<f4", 3 * section.buckets, start + 4 * section.partial).reshape(-1, 3)
    result: Array = centres[bucket]
    return result
