"""``.sog`` files (PlayCanvas): a zip or a folder of lossless WebP images whose pixels are one time's Gaussians.

Places are 16 bits of a logarithm, turns 8 bits a number, sizes and colours places in a table of 256, harmonics entries
of a palette. Version 2 is written. No file says which way is up.
"""

import io
import json
import math
import zipfile
from collections.abc import Callable
from functools import partial
from pathlib import Path

import numpy as np

from ..arrays import Array
from ..capture.video import load_opencv
from ..errors import brief
from ..gaussians import GaussianArrays, NumpyGaussians
from ..io.paths import read_beside
from ..io.plain_values import JsonObject, UnfitValue, entries, items, numbers, plain_json, text, whole
from ..io.unpacking import zip_member
from ..playback.frame_delta import canonical_arrays
from ..scene.quantization import morton_order
from .stills import ANTIALIASED, AS_THEY_ARE, Part, as_bytes, completed, largest_and_others

EXPECTED = "a .sog file, or the meta.json of one"
_MOST = 1 << 28  # Gaussians: the pixels of the largest WebP
_LARGEST_IMAGE = 1 << 30
_ACROSS = 64  # entries of a palette side by side
_MOST_ROWS = 1 << 16  # of a palette, which two bytes name
_ALIKE = 1e-10  # variance of harmonics that are not told apart
_BINS, _CLOSER, _GAPS, _LEVELS = 4096, 0.15, 1e-6, 64
"""Of a table: bins of a histogram; the power of a density to which levels lie closer; the density of empty bins, so
that numbers on both sides of a gap are told apart; levels of harmonics, which take the most room. A palette of fewer
rows than it may have would lose far more than it saves."""
_LOSSLESS = 101  # a quality of OpenCV's


def sog_bytes(gaussians: NumpyGaussians) -> bytes:
    """An archive of Gaussians with the axes that they have, along a curve through space, which packs images well.

    Raises:
        ImportError: without OpenCV.
    """
    g = gaussians.checked()
    g = g.part(morton_order(g.means))
    logarithms = np.sign(g.means) * np.log1p(np.abs(g.means.astype(np.float64)))
    low, high = logarithms.min(axis=0), logarithms.max(axis=0)
    places = np.rint((logarithms - low) / np.maximum(high - low, 1e-12) * 65535).astype(np.int64)
    largest, others = largest_and_others(g.quaternions)
    turns = np.column_stack([as_bytes((others / math.sqrt(2) + 0.5) * 255), 252 + largest])
    sizes, size_table = _coded(canonical_arrays(g)["log_scales"])
    colors, color_table = _coded(g.sh[:, 0])
    width = 4 * math.ceil(math.sqrt(len(g)) / 4)
    images = {
        "means_l.webp": _image(places & 255, width),
        "means_u.webp": _image(places >> 8, width),
        "scales.webp": _image(sizes, width),
        "quats.webp": _image(turns, width),
        "sh0.webp": _image(np.column_stack([colors, as_bytes(g.opacities * 255)]), width),
    }
    meta: JsonObject = {
        "version": 2,
        "asset": {"generator": "frog_blender"},
        "count": len(g),
        "means": {"mins": low.tolist(), "maxs": high.tolist(), "files": ["means_l.webp", "means_u.webp"]},
        "scales": {"codebook": size_table, "files": ["scales.webp"]},
        "quats": {"files": ["quats.webp"]},
        "sh0": {"codebook": color_table, "files": ["sh0.webp"]},
    }
    if g.sh_degree:
        palette, labels = _palette(g.sh[:, 1:].reshape(len(g), -1), g.opacities + 1e-6)
        codes, table = _coded(palette, _LEVELS)
        meta["shN"] = {"count": len(palette), "bands": g.sh_degree, "codebook": table}
        meta["shN"]["files"] = ["shN_centroids.webp", "shN_labels.webp"]
        images["shN_centroids.webp"] = _image(codes.reshape(-1, 3), _ACROSS * (g.sh.shape[1] - 1))
        images["shN_labels.webp"] = _image(np.column_stack([labels & 255, labels >> 8, 0 * labels]), width)
    content = io.BytesIO()
    with zipfile.ZipFile(content, "w") as archive:
        for name, part in (images | {"meta.json": json.dumps(meta).encode()}).items():
            archive.writestr(zipfile.ZipInfo(name), part)  # without a time: the same scene is the same file
    return content.getvalue()


def _coded(numbers: Array, levels: int = 256) -> tuple[Array, list[float]]:
    """Places in a table of 256, of which so many are used, and the table: means between borders that lie almost evenly,
    as takes the least room in images, and a little closer where most numbers are."""
    counts, edges = np.histogram(numbers.astype(np.float64), _BINS)
    shares = np.append(0.0, ((counts + _GAPS) ** _CLOSER).cumsum())
    borders = np.interp(np.linspace(0, shares[-1], levels + 1)[1:-1], shares, edges)
    codes = borders.searchsorted(numbers)
    sizes = np.bincount(codes.reshape(-1), minlength=256)
    sums = np.bincount(codes.reshape(-1), numbers.reshape(-1), minlength=256)
    return codes.astype(np.uint8), (sums / np.maximum(sizes, 1)).tolist()


def _palette(rows: Array, weights: Array) -> tuple[Array, Array]:
    """Rows that stand for all (N, D), and which of them each is (N,): where two bytes cannot name all, means of cells,
    of which those that differ most by weight (N,) are halved until there are enough."""
    if len(rows) <= _MOST_ROWS:
        return rows, np.arange(len(rows))

    def sums(numbers: Array) -> Array:
        return np.stack([np.bincount(cells, weights * column) for column in numbers.T], axis=1)

    everyone, cells, count = np.arange(len(rows)), np.zeros(len(rows), np.int64), 1
    while True:
        shares = np.bincount(cells, weights)
        means = sums(rows) / shares[:, None]
        off = rows - means[cells]
        spread = sums(np.square(off))
        axis, worst = spread.argmax(axis=1), spread.max(axis=1)
        halved = np.argsort(-worst)[: min(count // 2 + 1, _MOST_ROWS - count)]
        halved = halved[worst[halved] > _ALIKE * shares[halved]]
        if not len(halved):
            return means, cells
        fresh = np.full(count, -1)
        fresh[halved] = count + np.arange(len(halved))
        moved = (off[everyone, axis[cells]] > 0) & (fresh[cells] >= 0)
        cells[moved] = fresh[cells[moved]]
        count += len(halved)


def _image(pixels: Array, width: int) -> bytes:
    """Lossless WebP of (N, 3 or 4) bytes, row by row."""
    cv2 = load_opencv()
    image = np.full((-(-len(pixels) // width) * width, 4), 255, np.uint8)
    image[: len(pixels), : pixels.shape[1]] = pixels
    options = [cv2.IMWRITE_WEBP_QUALITY, _LOSSLESS]
    return bytes(cv2.imencode(".webp", image[:, [2, 1, 0, 3]].reshape(-1, width, 4), options)[1])


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
            raise UnfitValue(f"version {brief(self._meta.get('version'))}", EXPECTED)
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
        widths = [_ACROSS * ((degree + 1) ** 2 - 1) for degree in (1, 2, 3)]
        if palette.shape[1] not in widths:
            raise UnfitValue(f"a palette {palette.shape[1]} pixels wide", f"one of {widths}")
        rows = palette.reshape(-1, palette.shape[1] // _ACROSS, palette.shape[2])[:, :, :3]
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
