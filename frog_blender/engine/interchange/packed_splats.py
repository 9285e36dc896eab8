"""``.splat`` and ``.ksplat`` files: one time's Gaussians in a few bytes each. No file says which way is up.

- ``.splat`` (antimatter15/splat): 32 bytes a Gaussian, without harmonics. Place and size as float32, colour and opacity
  in 8 bits, the turn in 8 bits a number.
- ``.ksplat`` (mkkellogg/GaussianSplats3D): sections of Gaussians, in floats or about the centres of buckets.
"""

import struct
from collections import namedtuple
from itertools import pairwise
from pathlib import Path

import numpy as np

from ..arrays import Array
from ..gaussians import GaussianArrays, NumpyGaussians, joined
from ..io.plain_values import UnfitValue
from ..spherical_harmonics import SH_DC
from .stills import AS_THEY_ARE, Part

SPLAT, KSPLAT = "a .splat file, 32 bytes a Gaussian", "a .ksplat file of version 0.1"
"""What the readers expect."""
_ROW = np.dtype([("mean", "<f4", 3), ("scale", "<f4", 3), ("rgba", "u1", 4), ("turn", "u1", 4)])
_MAIN, _SECTION = 4096, 1024  # bytes of the headers
_HEAD, _SECTION_HEAD = struct.Struct("<4xI12xH14x2f"), struct.Struct("<4IfH2xI4x2IH")
_Section = namedtuple(
    "_Section", "count, capacity, bucket_capacity, buckets, block, bucket_bytes, step_range, full, partial, degree"
)
"""Gaussians that it has and has room for; how many share a centre, and how many centres there are; extent of a bucket,
bytes of a centre, steps from it to a side; buckets that are full and that are not; degree of the harmonics."""
_HARMONICS = (0, 9, 24)  # numbers of degree 0, 1 and 2
_COMMON_RANGE = 32767
_LEAST_HARMONIC = 1.5


def decode_splat(_path: Path, content: bytes) -> list[Part]:
    """Gaussians with the file's own axes; UnfitValue for any other content."""
    if not content or len(content) % _ROW.itemsize:
        raise UnfitValue(f"{len(content):,} bytes", SPLAT)
    table = np.frombuffer(content, _ROW)
    colors = (table["rgba"][:, :3] / 255.0 - 0.5) / SH_DC
    turns = (table["turn"].astype(np.float64) - 128) / 128
    opacities = table["rgba"][:, 3] / 255.0
    return [Part(GaussianArrays(table["mean"], turns, table["scale"], opacities, colors[:, None]), AS_THEY_ARE)]


def decode_ksplat(_path: Path, content: bytes) -> list[Part]:
    """Gaussians with the file's own axes; UnfitValue for any other content."""
    if len(content) < _MAIN or content[0] != 0 or content[1] < 1:
        raise UnfitValue("no such header", KSPLAT)
    sections, level, low, high = _HEAD.unpack_from(content)
    if level > 2 or not 1 <= sections <= len(content) // _SECTION:
        raise UnfitValue(f"{sections:,} sections of compression {level}", KSPLAT)
    bounds = low or -_LEAST_HARMONIC, high or _LEAST_HARMONIC
    start = _MAIN + sections * _SECTION
    if start > len(content):
        raise UnfitValue(f"{len(content):,} bytes", "room for the sections' headers")
    parts = []
    for index in range(sections):
        section = _Section._make(_SECTION_HEAD.unpack_from(content, _MAIN + index * _SECTION))
        if section.count > section.capacity or section.degree >= len(_HARMONICS):
            said = f"{section.count:,} Gaussians of degree {section.degree} in a section for {section.capacity:,}"
            raise UnfitValue(said, KSPLAT)
        gaussians, start = _read_section(content, start, section, level, bounds)
        if len(gaussians):
            parts.append(gaussians)
    if not parts:
        raise UnfitValue("no Gaussians", KSPLAT)
    return [Part(joined(parts), AS_THEY_ARE)]


def _read_section(
    content: bytes, start: int, section: _Section, level: int, bounds: tuple[float, float]
) -> tuple[NumpyGaussians, int]:
    """The Gaussians of a section, and where the next one begins."""
    further = _HARMONICS[section.degree]
    place, size, harmonic = [("<f4", "<f4", "<f4"), ("<u2", "<f2", "<f2"), ("<u2", "<f2", "u1")][level]
    row = np.dtype(
        [("mean", place, 3), ("scale", size, 3), ("turn", size, 4), ("rgba", "u1", 4), ("sh", harmonic, (further,))]
    )
    first = start + 4 * section.partial + section.bucket_bytes * section.buckets
    end = first + row.itemsize * section.capacity
    if end > len(content):
        raise UnfitValue(f"{len(content):,} bytes", f"the {end:,} that the headers announce")
    table = np.frombuffer(content, row, section.count, first)
    means = table["mean"].astype(np.float64)
    if level and section.count:
        centres = _centres(content, start, section)
        steps = section.step_range or _COMMON_RANGE
        means = (means - steps) * (section.block / 2 / steps) + centres
    colors = ((table["rgba"][:, :3] / 255.0 - 0.5) / SH_DC)[:, None]
    harmonics = table["sh"].astype(np.float64)
    if level == 2:
        harmonics = bounds[0] + harmonics / 255 * (bounds[1] - bounds[0])
    ends = [3 * (degree**2 - 1) for degree in range(1, section.degree + 2)]
    by_degree = [harmonics[:, begin:end] for begin, end in pairwise(ends)]  # of each all of red, then green, then blue
    sh = [colors, *(part.reshape(len(part), 3, part.shape[1] // 3).transpose(0, 2, 1) for part in by_degree)]
    opacities = table["rgba"][:, 3] / 255.0
    return GaussianArrays(means, table["turn"], table["scale"], opacities, np.concatenate(sh, axis=1)), end


def _centres(content: bytes, start: int, section: _Section) -> Array:
    """(N, 3) the centre of each Gaussian's bucket: the full ones come first."""
    if section.bucket_bytes != 12 or not np.isfinite(section.block) or section.full + section.partial > section.buckets:
        raise UnfitValue("buckets that cannot be", KSPLAT)
    sizes = np.frombuffer(content, "<u4", section.partial, start).astype(np.int64)
    in_full = section.full * section.bucket_capacity
    rest = section.count - min(in_full, section.count)
    if sizes.sum() < rest:
        raise UnfitValue(f"buckets for {in_full + int(sizes.sum()):,} Gaussians", f"for {section.count:,}")
    bucket = np.arange(section.count - rest) // max(section.bucket_capacity, 1)
    ends = np.cumsum(sizes)
    bucket = np.concatenate([bucket, section.full + np.searchsorted(ends, np.arange(rest), "right")])
    centres = np.frombuffer(content, "<f4", 3 * section.buckets, start + 4 * section.partial).reshape(-1, 3)
    return np.asarray(centres[bucket])
