"""``.splat``, ``.ksplat`` and ``.sog`` files: one time's Gaussians in a few bytes each. No file says which way is up.

- ``.splat`` (antimatter15/splat): 32 bytes a Gaussian, without harmonics. Place and size as float32, colour and opacity
  in 8 bits, the turn in 8 bits a number.
- ``.ksplat`` (mkkellogg/GaussianSplats3D): sections of Gaussians, in floats or about the centres of buckets.
- ``.sog`` (PlayCanvas): a zip or a folder of lossless WebP images whose pixels are Gaussians. Places are 16 bits of a
  logarithm, turns 8 bits a number, sizes and colours places in a table of 256, harmonics entries of a palette.
"""

import io
import struct
import zipfile
from collections import namedtuple
from collections.abc import Callable
from functools import partial
from itertools import pairwise
from pathlib import Path

import numpy as np

from ..arrays import Array
from ..capture.video import load_opencv
from ..errors import brief
from ..gaussians import GaussianArrays, NumpyGaussians, joined
from ..io.paths import read_beside
from ..io.plain_values import JsonObject, UnfitValue, entries, items, numbers, plain_json, text, whole
from ..io.unpacking import zip_member
from ..spherical_harmonics import SH_DC
from .stills import ANTIALIASED, AS_THEY_ARE, Part, completed

SPLAT, KSPLAT = "a .splat file, 32 bytes a Gaussian", "a .ksplat file of version 0.1"
SOG = "a .sog file, or the meta.json of one"
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
_MOST = 1 << 28  # Gaussians: the pixels of the largest WebP
_LARGEST_IMAGE = 1 << 30
_PALETTE_COLUMNS = 64


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


def decode_sog(path: Path, content: bytes) -> list[Part]:
    """Gaussians with the file's own axes, of an archive or of ``meta.json`` beside its images.

    OpenCV decodes these, in a process of its own (see imports): an image's header may ask for a gigabyte.
    """
    if path.suffix == ".json":
        return [_Sog(content, partial(read_beside, path, what="an image", most=_LARGEST_IMAGE)).part()]
    with zipfile.ZipFile(io.BytesIO(content)) as archive:
        return [_Sog(zip_member(archive, "meta.json"), partial(zip_member, archive)).part()]


class _Sog:
    """Version 2 has tables of 256 numbers; before, 8 bits lay evenly between two, and opacities were logits."""

    def __init__(self, meta: bytes, read: Callable[[str], bytes]) -> None:
        self._read = read
        self._meta = entries(plain_json(meta.decode(), "meta.json"), "meta.json")
        self._is_old = "version" not in self._meta and "shape" in entries(self._meta.get("means"), "means")
        if not self._is_old and self._meta.get("version") != 2:
            raise UnfitValue(f"version {brief(self._meta.get('version'))}", SOG)
        shape = items(self._meta["means"]["shape"], "the shape", 2) if self._is_old else [self._meta.get("count")]
        self._count = whole(shape[0] if shape else None, "the count", 1, _MOST)

    def part(self) -> Part:
        """What the file holds."""
        means = entries(self._meta.get("means"), "means")
        low, high = (numbers(means.get(name), name, (3,), 1e3) for name in ("mins", "maxs"))
        fine, coarse = (self._image(means, index)[:, :3].astype(np.float32) for index in (0, 1))
        logarithms = low + (high - low) * ((fine + 256 * coarse) / 65535)
        places = np.sign(logarithms) * np.expm1(np.minimum(np.abs(logarithms), 80.0))
        scales, colors = (entries(self._meta.get(name), name) for name in ("scales", "sh0"))
        color_image = self._image(colors, 0)
        sizes = self._numbers(scales, self._image(scales, 0)[:, :3])
        shown = self._numbers(colors, color_image if self._is_old else color_image[:, :3])
        opacities = 1 / (1 + np.exp(-shown[:, 3])) if self._is_old else color_image[:, 3] / np.float32(255)
        sh = shown[:, None, :3]
        if "shN" in self._meta:
            sh = np.concatenate([sh, self._harmonics(entries(self._meta["shN"], "shN"))], axis=1)
        turns = _turns(self._image(entries(self._meta.get("quats"), "quats"), 0))
        gaussians = GaussianArrays(places, turns, np.exp(np.minimum(sizes, 80)), opacities, sh)
        is_antialiased = self._meta.get("antialias") is True or self._meta.get("model") == "antialiased"
        return Part(gaussians, AS_THEY_ARE, (ANTIALIASED,) if is_antialiased else ())

    def _harmonics(self, described: JsonObject) -> Array:
        """(N, K, 3) of the degrees from 1 on: each Gaussian names a row of a palette."""
        palette = self._pixels(described, 0)
        labels = self._image(described, 1).astype(np.int64)
        widths = [_PALETTE_COLUMNS * ((degree + 1) ** 2 - 1) for degree in (1, 2, 3)]
        if palette.shape[1] not in widths:
            raise UnfitValue(f"a palette {palette.shape[1]} pixels wide", f"one of {widths}")
        rows = palette.reshape(-1, palette.shape[1] // _PALETTE_COLUMNS, palette.shape[2])[:, :, :3]
        chosen = labels[:, 0] + 256 * labels[:, 1]
        if chosen.max() >= len(rows):
            raise UnfitValue(f"row {chosen.max():,} of a palette", f"fewer than {len(rows):,}")
        return self._numbers(described, rows)[chosen]

    def _numbers(self, described: JsonObject, codes: Array) -> Array:
        """(..., C) float32 that bytes stand for."""
        if not self._is_old:
            table = numbers(described.get("codebook"), "a codebook", (256,), 1e6).astype(np.float32)
            return table[codes]
        ends = [described.get(name) for name in ("mins", "maxs")]
        if not isinstance(ends[0], list):  # one for all harmonics
            ends = [[end] * codes.shape[-1] for end in ends]
        low, high = (numbers(end, "an end of a range", (codes.shape[-1],), 1e6) for end in ends)
        return np.asarray(low + (high - low) * (codes / 255), np.float32)

    def _image(self, described: JsonObject, index: int) -> Array:
        """(N, 4) red, green, blue and alpha of the Gaussians' pixels."""
        pixels = self._pixels(described, index)
        flat = pixels.reshape(-1, pixels.shape[2])
        if len(flat) < self._count:
            raise UnfitValue(f"an image of {len(flat):,} pixels", f"{self._count:,}")
        flat = flat[: self._count]
        return flat if flat.shape[1] == 4 else np.pad(flat, ((0, 0), (0, 1)), constant_values=255)

    def _pixels(self, described: JsonObject, index: int) -> Array:
        """(H, W, 3 or 4) uint8."""
        names = items(described.get("files"), "files", 8)
        if index >= len(names):
            raise UnfitValue(f"{len(names)} files", f"at least {index + 1}")
        name = text(names[index], "a file's name", 1024)
        cv2 = load_opencv()
        content = np.frombuffer(self._read(name), np.uint8)
        try:
            image = cv2.imdecode(content, cv2.IMREAD_UNCHANGED) if len(content) else None
        except cv2.error as error:
            raise UnfitValue(f"{brief(name)}, which cannot be decoded", "a lossless WebP image") from error
        if image is None or image.dtype != np.uint8 or image.ndim != 3:
            raise UnfitValue(f"{brief(name)}, which is no image in colours", "a lossless WebP image")
        return np.asarray(image[:, :, [2, 1, 0, *range(3, image.shape[2])]])


def _turns(pixels: Array) -> Array:
    """(N, 4) w, x, y, z; alpha names the largest of them, which is left out."""
    largest = pixels[:, 3].astype(np.int64) - 252
    turns = completed((pixels[:, :3] / 255.0 * 2 - 1) / np.sqrt(2), largest.clip(0))
    turns[largest < 0] = (1, 0, 0, 0)
    return turns
