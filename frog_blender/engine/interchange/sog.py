"""``.sog`` files (PlayCanvas) of version 2: a zip of lossless WebP images whose pixels are Gaussians.

Places are 16 bits of a logarithm, turns 8 bits a number, sizes and colours places in a table of 256, harmonics entries
of a palette. No file says which way is up. OpenCV decodes the images, in a process of its own (see import_process): an
image's header may ask for a gigabyte.
"""

from __future__ import annotations

import io
import zipfile
import zlib
from pathlib import Path

import numpy as np

from ..arrays import Array
from ..capture.video import load_opencv
from ..errors import brief, found_instead
from ..gaussians import GaussianArrays
from ..io.plain_values import JsonObject, UnfitValue, entries, items, numbers, plain_json, text, whole
from ..io.regular_file import regular_file
from .activated import usable
from .frame_source import StillSource

_EXPECTED = "a .sog file of version 2"
_MOST = 1 << 28  # Gaussians: the pixels of the largest WebP
_LONGEST_META, _LARGEST_IMAGE = 16 << 20, 1 << 30
_PALETTE_COLUMNS = 64
_HARMONICS = {1: 3, 2: 8, 3: 15}
_OTHERS = np.array([[1, 2, 3], [0, 2, 3], [0, 1, 3], [0, 1, 2]])


def open_sog(path: Path) -> StillSource:
    """The Gaussians of a file, with its own axes; FrogError for any other file."""
    content = regular_file(path, _EXPECTED).read_bytes()
    try:
        with zipfile.ZipFile(io.BytesIO(content)) as archive:
            return _Archive(path, archive).source()
    except UnfitValue as error:
        raise found_instead(path, error.found, error.expected) from error
    except (zipfile.BadZipFile, zlib.error, OSError, LookupError, ValueError, RuntimeError, EOFError) as error:
        raise found_instead(path, f"a damaged or foreign file ({brief(error)})", _EXPECTED) from error


class _Archive:
    def __init__(self, path: Path, archive: zipfile.ZipFile) -> None:
        self._path, self._archive = path, archive
        meta = entries(plain_json(self._member("meta.json", _LONGEST_META).decode(), "meta.json"), "meta.json")
        if meta.get("version") != 2:
            raise UnfitValue(f"version {brief(meta.get('version'))}", _EXPECTED)
        self._meta, self._count = meta, whole(meta.get("count"), "the count", 1, _MOST)

    def source(self) -> StillSource:
        """What the file holds."""
        means = entries(self._meta.get("means"), "means")
        low, high = (numbers(means.get(name), name, (3,), 1e3) for name in ("mins", "maxs"))
        fine, coarse = (self._image(means, place)[:, :3].astype(np.float64) for place in (0, 1))
        logarithms = low + (high - low) * ((fine + 256 * coarse) / 65535)
        places = np.sign(logarithms) * np.expm1(np.minimum(np.abs(logarithms), 80.0))
        scales, colors = (entries(self._meta.get(name), name) for name in ("scales", "sh0"))
        color_image = self._image(colors, 0)
        sizes = self._table(scales)[self._image(scales, 0)[:, :3]]
        sh = self._table(colors)[color_image[:, :3]][:, None]
        if "shN" in self._meta:
            sh = np.concatenate([sh, self._harmonics(entries(self._meta["shN"], "shN"))], axis=1)
        turns = _turns(self._image(entries(self._meta.get("quats"), "quats"), 0))
        made = GaussianArrays(places, turns, np.exp(np.minimum(sizes, 80)), color_image[:, 3] / 255.0, sh)
        gaussians, left_out = usable(self._path, made, keep_rows=False)
        return StillSource(gaussians, "sog", left_out)

    def _harmonics(self, found: JsonObject) -> Array:
        """(N, K, 3) of the degrees from 1 on: each Gaussian names a row of a palette."""
        degree = whole(found.get("bands"), "bands", 1, 3)
        width = _HARMONICS[degree]
        palette = self._pixels(found, 0)
        labels = self._image(found, 1).astype(np.int64)
        if palette.shape[1] != _PALETTE_COLUMNS * width:
            raise UnfitValue(f"a palette {palette.shape[1]} pixels wide", f"{_PALETTE_COLUMNS * width}")
        rows = palette.reshape(-1, width, palette.shape[2])[:, :, :3]
        chosen = labels[:, 0] + 256 * labels[:, 1]
        if chosen.max() >= len(rows):
            raise UnfitValue(f"row {chosen.max():,} of a palette", f"fewer than {len(rows):,}")
        result: Array = self._table(found)[rows[chosen]]
        return result

    def _table(self, found: JsonObject) -> Array:
        return numbers(found.get("codebook"), "a codebook", (256,), 1e6).astype(np.float32)

    def _image(self, found: JsonObject, place: int) -> Array:
        """(N, 4) red, green, blue and alpha of the Gaussians' pixels."""
        pixels = self._pixels(found, place)
        flat = pixels.reshape(-1, pixels.shape[2])
        if len(flat) < self._count:
            raise UnfitValue(f"an image of {len(flat):,} pixels", f"{self._count:,}")
        flat = flat[: self._count]
        return flat if flat.shape[1] == 4 else np.pad(flat, ((0, 0), (0, 1)), constant_values=255)

    def _pixels(self, found: JsonObject, place: int) -> Array:
        """(H, W, 3 or 4) uint8."""
        names = items(found.get("files"), "files", 8)
        if place >= len(names):
            raise UnfitValue(f"{len(names)} files", f"at least {place + 1}")
        name = text(names[place], "a file's name", 1024)
        cv2 = load_opencv()
        content = np.frombuffer(self._member(name, _LARGEST_IMAGE), np.uint8)
        try:
            image = cv2.imdecode(content, cv2.IMREAD_UNCHANGED) if len(content) else None
        except cv2.error as error:
            raise UnfitValue(f"{brief(name)}, which cannot be decoded", "a lossless WebP image") from error
        if image is None or image.dtype != np.uint8 or image.ndim != 3:
            raise UnfitValue(f"{brief(name)}, which is no image in colours", "a lossless WebP image")
        result: Array = image[:, :, [2, 1, 0, *range(3, image.shape[2])]]
        return result

    def _member(self, name: str, largest: int) -> bytes:
        entry = self._archive.getinfo(name)
        if entry.file_size > min(largest, 1032 * max(entry.compress_size, 1)):
            raise UnfitValue(f"{entry.file_size:,} bytes of {brief(name)}", "what its size allows for")
        with self._archive.open(entry) as file:
            return file.read(entry.file_size)


def _turns(pixels: Array) -> Array:
    """(N, 4) w, x, y, z; alpha names the largest of them, which is left out."""
    largest = pixels[:, 3].astype(np.int64) - 252
    valid = largest >= 0
    largest = largest.clip(0)
    others = (pixels[:, :3] / 255.0 * 2 - 1) / np.sqrt(2)
    turns = np.zeros((len(pixels), 4))
    np.put_along_axis(turns, _OTHERS[largest], others, axis=1)
    turns[np.arange(len(turns)), largest] = np.sqrt(np.maximum(1 - np.square(others).sum(axis=1), 0))
    turns[~valid] = (1, 0, 0, 0)
    return turns
