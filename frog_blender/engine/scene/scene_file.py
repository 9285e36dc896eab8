"""The ``.frog`` scene file: one safetensors file with a JSON header. No pickle, no torch.

Tensors of a FRoG scene: ``means, log_scales, quaternions, opacity_logits, sh`` by Gaussian,
``embeddings`` of those that are deformed, which come first, ``temporal_table`` and ``network.*``. The header holds what
playback and evaluation need besides.

Frames that another program made stay on the disk: a scene of the method SEQUENCE holds each frame's changing columns
as one row of the tensor ``frames`` (F, bytes of a row), which is read row by row: however long a sequence is, a frame
of it is all that is held. A row is the columns that the header's model names (see playback.frame_delta for their
widths), one after the other, each of all dynamic Gaussians, which come first. They are float32, or but for places
float16. Where another program says by a formula how its Gaussians move, ``curves`` take the place of ``frames``.
"""

from __future__ import annotations

import json
import math
import re
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from safetensors.numpy import save as serialize

from ..arrays import Array, SceneArrays
from ..errors import FrogError, found_instead, in_words
from ..field.names import CANONICAL, CURVES, SEQUENCE
from ..io.atomic_files import write_atomically
from ..io.plain_values import JsonObject, UnfitValue, entries, plain_json, typed, whole
from ..io.tensor_files import framed_header, opened_tensors, read_header, read_tensors
from ..registry import METHODS, Method
from .header import SceneHeader
from .quantization import Packed, pack, unpack_scene

FRAMES = "frames"
_KIND = "a .frog scene"
WIDTHS = {"means": 3, "quaternions": 4, "scales": 3, "base": 4, **{f"sh_{k}": 3 for k in range(1, 16)}}
"""Numbers that a Gaussian has in each column, see playback.frame_delta."""
HALF = -65504.0, 65504.0
"""The least and the largest half float."""


@dataclass(frozen=True)
class RowLayout:
    """What a row is made of: the model settings of a sequence.

    Attributes:
        dynamic: how many Gaussians change, the first ones.
        columns: names of those that do, in their order.
        keeps_identity: whether the same row is the same Gaussian in all frames, so that there is something between two.
        half: whether all but places are half floats.
    """

    dynamic: int
    columns: tuple[str, ...]
    keeps_identity: bool = True
    half: bool = False

    def kind(self, name: str) -> str:
        """A column's type."""
        return "<f2" if self.half and name != "means" else "<f4"

    @property
    def size(self) -> int:
        """Bytes of a row."""
        return self.dynamic * sum(WIDTHS[name] * np.dtype(self.kind(name)).itemsize for name in self.columns)

    def packed(self, columns: dict[str, Array]) -> Array:
        """(size,) uint8, a row of the columns' float32."""
        kinds = {name: self.kind(name) for name in self.columns}
        bounded = {name: columns[name].clip(*HALF) if kind == "<f2" else columns[name] for name, kind in kinds.items()}
        parts = [np.ascontiguousarray(bounded[name], kind).view(np.uint8).ravel() for name, kind in kinds.items()]
        return np.concatenate([*parts, np.zeros(0, np.uint8)])  # bytes would keep all other threads waiting

    def unpacked(self, row: Array) -> dict[str, Array]:
        """(M, width) by column of a row of bytes, as they are stored; views of it."""
        columns, start = {}, 0
        for name in self.columns:
            shape = self.dynamic, WIDTHS[name]
            columns[name] = np.frombuffer(row, self.kind(name), math.prod(shape), start).reshape(shape)
            start += columns[name].nbytes
        return columns

    @classmethod
    def of(cls, header: SceneHeader, num_gaussians: int) -> RowLayout:
        """The layout that a sequence's header describes; UnfitValue for a header that describes none."""
        layout: RowLayout = typed(cls, dict(header.model), "the model")
        whole(layout.dynamic, "dynamic", 0, num_gaussians)
        if len(set(layout.columns)) != len(layout.columns) or not set(layout.columns) <= WIDTHS.keys():
            raise UnfitValue(f"the columns {', '.join(layout.columns)}", f"some of {', '.join(WIDTHS)}")
        return layout


@dataclass(frozen=True)
class FrameRows:
    """The rows of a sequence; safe to use from any thread.

    Attributes:
        path: of the file, which is opened for each row: nothing is kept from replacing it.
        stamp: its modification time and size when it was found.
        begin: first byte of the first row.
        count: rows.
        layout: what they are made of.
        kept: (M,) which of their Gaussians are wanted, ascending; None for all.
    """

    path: Path
    stamp: tuple[int, int]
    begin: int
    count: int
    layout: RowLayout
    kept: Array | None = None

    def __len__(self) -> int:
        """Dynamic Gaussians that are wanted."""
        return self.layout.dynamic if self.kept is None else len(self.kept)

    def subset(self, kept: Array) -> FrameRows:
        """Rows of some of the scene's Gaussians.

        Args:
            kept: (K,) indices of those wanted now, ascending; static ones among them are passed over.
        """
        dynamic = kept[kept < len(self)]
        return replace(self, kept=dynamic if self.kept is None else self.kept[dynamic])

    def at(self, frame: int) -> dict[str, Array]:
        """(M, width) float32 by column of a frame; FrogError where the file was changed or cannot be read."""
        content = np.empty(self.layout.size, np.uint8)
        with in_words(f"{self.path}: a frame could not be read"), self.path.open("rb", buffering=0) as file:
            if stamp_of(self.path) != self.stamp:
                raise found_instead(self.path, "another version of it than was opened", "the same; open it again")
            file.seek(self.begin + frame * len(content))
            length = file.readinto(content.data)
        if length != len(content):
            raise found_instead(self.path, f"{length:,} bytes of frame {frame}", f"{len(content):,}")
        columns = self.layout.unpacked(content)
        if self.kept is not None:  # indexing takes four times as long
            columns = {name: column.take(self.kept, axis=0) for name, column in columns.items()}
        return {name: column.astype(np.float32, copy=False) for name, column in columns.items()}


def find_rows(path: str | Path, header: SceneHeader, num_gaussians: int) -> FrameRows:
    """The rows of a sequence's file. UnfitValue or FrogError for a file that does not hold what its header says."""
    path, layout = Path(path), RowLayout.of(header, num_gaussians)
    with opened_tensors(path, _KIND) as file:
        tensor = read_header(file)[0].get(FRAMES)
    expected = (header.frame_count, layout.size)
    if tensor is None or tensor.shape != expected or tensor.dtype != "U8":
        said = f"shape {tensor.shape} and type {tensor.dtype}" if tensor else "nothing"
        raise UnfitValue(f"{FRAMES} of {said}", f"shape {expected} of bytes")
    return FrameRows(path, stamp_of(path), tensor.begin, header.frame_count, layout)


def stamp_of(path: Path) -> tuple[int, int]:
    """A file's modification time and size."""
    status = path.stat()
    return status.st_mtime_ns, status.st_size


_HEADER_KEY = "frog"
_PACKING_KEY = "packing"
_NETWORK = re.compile(r"network\.[a-z0-9_.]{1,80}")


@dataclass(frozen=True)
class SceneFile:
    """A scene as it lies on disk: header and arrays by name.

    Attributes:
        header: what it says of itself.
        arrays: all but ``rows``.
        rows: frames that stay on the disk, of a scene of the method SEQUENCE; else None.
    """

    header: SceneHeader
    arrays: SceneArrays
    rows: FrameRows | None = None


def settings_json(settings: Any) -> JsonObject:
    """A settings dataclass as JSON has it."""
    return dict(json.loads(json.dumps(asdict(settings))))


def write_scene(path: str | Path, scene: SceneFile, *, compact: bool = False) -> None:
    """Writes atomically; FrogError when it cannot, and then an earlier file of that name is untouched.

    Args:
        compact: quantise and compress (see quantization), which changes numbers invisibly.
    """
    write_atomically(path, scene_bytes(scene, compact=compact))


def scene_bytes(scene: SceneFile, *, compact: bool = False) -> bytes:
    """What ``write_scene`` writes."""
    arrays, metadata = packed_metadata(scene.header, scene.arrays, compact=compact)
    contiguous = {name: np.ascontiguousarray(array) for name, array in arrays.items()}
    return _in_order(bytes(serialize(contiguous, metadata=metadata)))


def _in_order(content: bytes) -> bytes:
    """The same file with its texts in one order: safetensors writes them in any, and equal scenes are equal files."""
    end = 8 + int.from_bytes(content[:8], "little")
    values = json.loads(content[8:end])
    values["__metadata__"] = dict(sorted(values["__metadata__"].items()))
    return framed_header(json.dumps(values, separators=(",", ":"), ensure_ascii=False)) + content[end:]


def packed_metadata(header: SceneHeader, arrays: SceneArrays, *, compact: bool) -> tuple[SceneArrays, dict[str, str]]:
    """A scene's arrays as they are stored, and the texts of the file's own header."""
    metadata = {_HEADER_KEY: header.to_json()}
    if compact:
        packed = packed_arrays(arrays)
        arrays = {name: part.content for name, part in packed.items()}
        metadata[_PACKING_KEY] = json.dumps({name: part.description for name, part in packed.items()})
    return arrays, metadata


def packed_arrays(arrays: SceneArrays) -> dict[str, Packed]:
    """FrogError for numbers that no packed file can hold."""
    try:
        return {name: pack(name, array) for name, array in arrays.items()}
    except ValueError as error:
        raise FrogError(f"The scene cannot be packed: {error}.") from error


def read_scene(path: str | Path) -> SceneFile:
    """FrogError in one sentence when it is missing, truncated, of another kind or of another version.

    Arrays that no scene of its method has are passed over.
    """
    field = METHODS["frog"]  # whose scenes have all arrays that others have, but for what a guest names
    arrays, metadata = read_tensors(path, "a .frog scene", lambda name: name == CURVES or _is_known(name, field))
    try:
        if _HEADER_KEY not in metadata:
            raise UnfitValue("a file without a scene's header", "a .frog scene")
        header = SceneHeader.from_json(metadata[_HEADER_KEY])
        method = None if header.method == SEQUENCE else METHODS[header.method]
        arrays = {name: array for name, array in arrays.items() if _is_known(name, method)}
        if method is not None and (own := method.arrays - field.arrays):
            arrays |= read_tensors(path, "a .frog scene", own.__contains__)[0]
        packing = entries(plain_json(metadata.get(_PACKING_KEY, "{}"), "packing"), "packing")
        described = {name: entries(packing[name], f"packing of {name}") for name in arrays if name in packing}
        if described:
            arrays |= _unpacked(arrays, described)
        _check_arrays(arrays)
        is_stored = header.method == SEQUENCE and CURVES not in arrays
        rows = find_rows(path, header, len(arrays["means"])) if is_stored else None
    except UnfitValue as error:
        raise found_instead(path, error.found, error.expected) from error
    return SceneFile(header, arrays, rows)


def _unpacked(arrays: SceneArrays, described: JsonObject) -> SceneArrays:
    """UnfitValue for bytes and descriptions that ``packed_arrays`` does not write."""
    try:
        return unpack_scene(arrays, described)
    except (KeyError, TypeError, ValueError, AttributeError, OverflowError, MemoryError) as error:
        raise UnfitValue(f"packed arrays that cannot be read ({error})", "a .frog scene") from error


def _is_known(name: str, method: Method | None) -> bool:
    """Whether a scene of that method, or of none, has such an array."""
    if name in CANONICAL or method is None:
        return name in CANONICAL or name == CURVES
    return name in method.arrays or (method.play is not None and _NETWORK.fullmatch(name) is not None)


def _check_arrays(arrays: SceneArrays) -> None:
    """UnfitValue for types and shapes that playback does not rely on."""
    for name, array in arrays.items():
        if array.dtype != np.float32:
            raise UnfitValue(f"{name} of type {array.dtype}", "float32")
    count = (arrays["means"].shape or (0,))[0] if "means" in arrays else 0
    for name, width in {"means": 3, "log_scales": 3, "quaternions": 4, "opacity_logits": None}.items():
        shape = (count, width) if width else (count,)
        actual = arrays[name].shape if name in arrays else "nothing"
        if actual != shape or not count:
            raise UnfitValue(f"{name} of shape {actual}", f"shape {shape} with at least one Gaussian")
    if CURVES in arrays and arrays[CURVES].shape != (count, 15):
        raise UnfitValue(f"{CURVES} of shape {arrays[CURVES].shape}", f"shape {(count, 15)}")
    sh = arrays.get("sh")
    if sh is None or sh.ndim != 3 or sh.shape[0] != count or sh.shape[1] not in (1, 4, 9, 16) or sh.shape[2] != 3:
        raise UnfitValue("no usable colours (sh)", f"shape ({count}, 1 | 4 | 9 | 16, 3)")
