"""The ``.frog`` scene file: one safetensors file with a JSON header. No pickle, no torch.

Tensors of a FRoG scene: ``means, log_scales, quaternions, opacity_logits, sh`` by Gaussian,
``embeddings`` of those that are deformed, which come first, ``temporal_table`` and ``network.*``, and where that saves
time at playback VISIBILITY (see playback.groups). The header holds what playback and evaluation need besides.
"""

from __future__ import annotations

import json
import re
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from safetensors.numpy import save as serialize

from ..arrays import SceneArrays
from ..errors import FrogError, found_instead
from ..field.names import CANONICAL, SEQUENCE
from ..io.atomic_files import write_atomically
from ..io.plain_values import JsonObject, UnfitValue, entries, plain_json
from ..io.tensor_files import read_tensors
from ..registry import METHODS, Method
from .frame_rows import FrameRows, find_rows
from .header import SceneHeader
from .quantization import Packed, pack, unpack_scene

VISIBILITY = "lifetimes"
"""Name of the array of bits that say when groups of Gaussians are visible (playback.groups)."""
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
    """A settings dataclass as plain values for a header."""
    return asdict(settings)


def write_scene(path: str | Path, scene: SceneFile, *, compact: bool = False) -> None:
    """Writes atomically; FrogError when it cannot, and then an earlier file of that name is untouched.

    Args:
        compact: quantise and compress (see quantization), which changes numbers invisibly.
    """
    write_atomically(path, scene_bytes(scene, compact=compact))


def scene_bytes(scene: SceneFile, *, compact: bool = False) -> bytes:
    """What ``write_scene`` writes."""
    arrays, metadata = packed_metadata(scene.header, scene.arrays, compact=compact)
    result: bytes = serialize(_contiguous(arrays), metadata=metadata)
    return result


def packed_metadata(header: SceneHeader, arrays: SceneArrays, *, compact: bool) -> tuple[SceneArrays, dict[str, str]]:
    """A scene's arrays as they are stored, and the texts of the file's own header."""
    metadata = {_HEADER_KEY: header.to_json()}
    if compact:
        packed = packed_arrays(arrays)
        arrays = {name: each.content for name, each in packed.items()}
        metadata[_PACKING_KEY] = json.dumps({name: each.description for name, each in packed.items()})
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
    arrays, metadata = read_tensors(path, "a .frog scene", lambda name: _is_known(name, field))
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
        rows = find_rows(path, header, len(arrays["means"])) if header.method == SEQUENCE else None
    except UnfitValue as error:
        raise found_instead(path, error.found, error.expected) from error
    return SceneFile(header, arrays, rows)


def _unpacked(arrays: SceneArrays, described: JsonObject) -> SceneArrays:
    """UnfitValue for bytes and descriptions that ``packed_arrays`` does not write."""
    try:
        return unpack_scene(arrays, described)
    except (KeyError, TypeError, ValueError, AttributeError, OverflowError, MemoryError) as error:
        raise UnfitValue(f"packed arrays that cannot be read ({error})", "a .frog scene") from error


def _contiguous(arrays: SceneArrays) -> SceneArrays:
    return {name: np.ascontiguousarray(array) for name, array in arrays.items()}


def _is_known(name: str, method: Method | None) -> bool:
    """Whether a scene of that method, or of none, has such an array."""
    if name in CANONICAL or method is None:
        return name in CANONICAL
    return name in method.arrays or (method.play is not None and _NETWORK.fullmatch(name) is not None)


def _check_arrays(arrays: SceneArrays) -> None:
    """UnfitValue for types and shapes that playback does not rely on."""
    for name, array in arrays.items():
        expected = np.uint8 if name == VISIBILITY else np.float32
        if array.dtype != expected:
            raise UnfitValue(f"{name} of type {array.dtype}", f"{expected.__name__}")
    count = (arrays["means"].shape or (0,))[0] if "means" in arrays else 0
    shapes: dict[str, tuple[int, ...]] = {
        "means": (count, 3),
        "log_scales": (count, 3),
        "quaternions": (count, 4),
        "opacity_logits": (count,),
    }
    for name, shape in shapes.items():
        found = arrays[name].shape if name in arrays else "nothing"
        if found != shape or not count:
            raise UnfitValue(f"{name} of shape {found}", f"shape {shape} with at least one Gaussian")
    sh = arrays.get("sh")
    if sh is None or sh.ndim != 3 or sh.shape[0] != count or sh.shape[1] not in (1, 4, 9, 16) or sh.shape[2] != 3:
        raise UnfitValue("no usable colours (sh)", f"shape ({count}, 1 | 4 | 9 | 16, 3)")
