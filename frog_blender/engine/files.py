"""The ``.frog`` scene file: one safetensors file with a JSON header. No pickle, no torch.

Tensors of a FRoG scene: ``means, log_scales, quaternions, opacity_logits, sh`` by Gaussian,
``embeddings`` of those that are deformed, which come first, ``temporal_table`` and ``network.*``, and where that saves
time at playback LIFETIMES (see inference.lifetimes) and, of those that come next, FADES (see model.fading). The
header holds what playback and evaluation need besides.
"""

from __future__ import annotations

import glob
import json
import os
import tempfile
from contextlib import suppress
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from safetensors import SafetensorError, safe_open
from safetensors.numpy import save as serialize

from .capacity_report import lines, summary
from .capture.camera import Camera
from .errors import FrogError, found_instead
from .packing import Packed, pack, unpack_scene

FORMAT_VERSION = 4
"""1 had every array as it is; 2 may have them packed; 3 may have lifetimes; 4 may have some that only fade."""
METHODS = ("frog", "ed3dgs", "static", "d3dgs", "hexplane", "curves")
LIFETIMES = "lifetimes"
"""Name of the array in which bits say when groups of Gaussians can be seen."""
FADES = "fades"
"""Name of the array (F, frames) in which opacities stand of those that only fade."""
RESHAPED = "reshaped"
"""The model setting that says how many of those that are deformed, the first, turn and grow; the others keep their
shape. All of them where it is missing."""
_HEADER_KEY = "frog"
_PACKING_KEY = "packing"


@dataclass(frozen=True)
class SceneHeader:
    """What a scene file says of itself.

    Attributes:
        method: one of METHODS.
        recipe: every setting of the training, as plain values.
        model: the model's settings (see FrogSettings), empty for a scene in which nothing moves.
        cameras: the capture's cameras at the size they were trained at; none for splats from elsewhere.
        camera_shots: for each camera the frames it saw; one frame each for a moving camera.
        test_cameras, test_frames: what training did not see.
        frame_count, frames_per_second: the capture's time axis; frame f has time f / (frame_count - 1).
        background: display-referred colour behind the Gaussians.
        capture_path, capture_format, scale, pixel_offsets: where the frames came from and how they were read.
        metrics: PSNR and so on as measured at the end of training.
        steps, train_seconds: how much training is in it (decoding and seeding not counted).
        capacity: what the training took out of the model (see training.parsimony), empty where it took nothing.
    """

    method: str
    recipe: dict[str, Any]
    model: dict[str, Any]
    cameras: tuple[Camera, ...]
    camera_shots: tuple[tuple[int, ...], ...]
    test_cameras: tuple[str, ...]
    test_frames: tuple[int, ...]
    frame_count: int
    frames_per_second: float
    background: tuple[float, float, float]
    capture_path: str
    capture_format: str
    scale: float
    pixel_offsets: dict[str, tuple[float, float]] = field(default_factory=dict)
    metrics: dict[str, Any] = field(default_factory=dict)
    steps: int = 0
    train_seconds: float = 0.0
    format_version: int = FORMAT_VERSION
    capacity: dict[str, Any] = field(default_factory=dict)

    @property
    def is_moving(self) -> bool:
        """One moving camera: every entry of ``cameras`` is one moment of it, or a withheld picture."""
        if any(len(frames) != 1 for frames in self.camera_shots):
            return False
        named = zip(self.cameras, self.camera_shots, strict=True)
        moments = [frame for camera, (frame,) in named if not self.is_test(camera.name, frame)]
        return len(moments) > 1 and len(set(moments)) == len(moments)

    def is_test(self, camera_name: str, frame: int) -> bool:
        """True for a picture that training did not see."""
        return camera_name in self.test_cameras or frame in self.test_frames

    def to_json(self) -> str:
        values = {name: getattr(self, name) for name in self.__dataclass_fields__ if name != "cameras"}
        return json.dumps({**values, "cameras": [camera.to_json() for camera in self.cameras]}, allow_nan=False)

    @classmethod
    def from_json(cls, text: str) -> SceneHeader:
        """Raises KeyError, TypeError or ValueError for a header that is not one."""
        data = json.loads(text)
        red, green, blue = (float(value) for value in data["background"])
        return cls(
            method=str(data["method"]),
            recipe=dict(data["recipe"]),
            model=dict(data["model"]),
            cameras=tuple(Camera.from_json(camera) for camera in data["cameras"]),
            camera_shots=tuple(tuple(int(frame) for frame in frames) for frames in data["camera_shots"]),
            test_cameras=tuple(str(name) for name in data["test_cameras"]),
            test_frames=tuple(int(frame) for frame in data["test_frames"]),
            frame_count=int(data["frame_count"]),
            frames_per_second=float(data["frames_per_second"]),
            background=(red, green, blue),
            capture_path=str(data["capture_path"]),
            capture_format=str(data["capture_format"]),
            scale=float(data["scale"]),
            pixel_offsets={str(k): (float(v[0]), float(v[1])) for k, v in data["pixel_offsets"].items()},
            metrics=dict(data["metrics"]),
            steps=int(data["steps"]),
            train_seconds=float(data["train_seconds"]),
            format_version=int(data["format_version"]),
            capacity=_checked_capacity(data.get("capacity", {})),  # version 1 had none
        )


@dataclass(frozen=True)
class SceneFile:
    """A scene as it lies on disk: header and arrays by name."""

    header: SceneHeader
    arrays: dict[str, np.ndarray]


def _checked_capacity(capacity: Any) -> dict[str, Any]:
    """KeyError, TypeError, ValueError or AttributeError for a report that nobody could read out."""
    capacity = dict(capacity)
    if capacity:
        summary(capacity)
        lines(capacity)
    return capacity


def settings_json(settings: Any) -> dict[str, Any]:
    """A settings dataclass as plain values for a header."""
    return asdict(settings)


def write_scene(path: str | Path, scene: SceneFile, *, compact: bool = False) -> None:
    """Writes atomically; FrogError when it cannot, and then an earlier file of that name is untouched.

    Args:
        compact: quantise and compress (see packing), which changes numbers by less than can be seen.
    """
    write_atomically(path, scene_bytes(scene, compact=compact))


def scene_bytes(scene: SceneFile, *, compact: bool = False) -> bytes:
    """What ``write_scene`` writes."""
    metadata = {_HEADER_KEY: scene.header.to_json()}
    arrays = scene.arrays
    if compact:
        packed = packed_arrays(arrays)
        arrays = {name: each.content for name, each in packed.items()}
        metadata[_PACKING_KEY] = json.dumps({name: each.description for name, each in packed.items()})
    return serialize(_contiguous(arrays), metadata=metadata)


def packed_arrays(arrays: dict[str, np.ndarray]) -> dict[str, Packed]:
    """FrogError for numbers that no packed file can hold."""
    try:
        return {name: pack(name, array) for name, array in arrays.items()}
    except ValueError as error:
        raise FrogError(f"The scene cannot be packed: {error}.") from error


def read_scene(path: str | Path) -> SceneFile:
    """FrogError in one sentence when it is missing, truncated, of another kind or of a newer version."""
    arrays, metadata = read_tensors(path, "a .frog scene")
    try:
        header = SceneHeader.from_json(metadata[_HEADER_KEY])
    except (KeyError, TypeError, ValueError, AttributeError, IndexError, OverflowError, RecursionError) as error:
        raise found_instead(path, f"a header that cannot be read ({error!r})", "a .frog scene") from error
    if header.format_version > FORMAT_VERSION:
        raise found_instead(
            path, f"format version {header.format_version}", f"at most {FORMAT_VERSION}; a newer frog_blender reads it"
        )
    try:
        packing = json.loads(metadata.get(_PACKING_KEY, "{}"))
        if packing:
            arrays |= unpack_scene(arrays, packing)
    except (KeyError, TypeError, ValueError, AttributeError, OverflowError, RecursionError, MemoryError) as error:
        raise found_instead(path, f"packed arrays that cannot be read ({error})", "a .frog scene") from error
    _check_arrays(path, header, arrays)
    return SceneFile(header, arrays)


def read_tensors(path: str | Path, kind: str) -> tuple[dict[str, np.ndarray], dict[str, str]]:
    """Arrays and metadata of a safetensors file; sizes are checked by the library before anything is allocated."""
    if not Path(path).is_file():
        raise found_instead(path, "no file", kind)
    try:
        with safe_open(str(path), framework="numpy") as file:
            return {name: file.get_tensor(name) for name in file.keys()}, dict(file.metadata() or {})  # noqa: SIM118
    except (SafetensorError, OSError, ValueError, TypeError) as error:
        raise found_instead(path, f"a damaged or foreign file ({error})", kind) from error


def write_atomically(path: str | Path, content: bytes) -> None:
    """To a temporary name beside ``path``, flushed to the disk, then renamed: never half a file under that name."""
    path = Path(path)
    temporary = None
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        handle, name = tempfile.mkstemp(prefix=f".{path.name}.", suffix=".part", dir=path.parent)
        temporary = Path(name)
        with os.fdopen(handle, "wb") as file:
            file.write(content)
            file.flush()
            os.fsync(file.fileno())
        temporary.chmod(0o644)
        temporary.replace(path)
    except OSError as error:
        if temporary is not None:
            temporary.unlink(missing_ok=True)
        raise FrogError(f"{path}: could not be written ({error.strerror or error}); nothing was changed.") from error


def remove_unfinished(path: str | Path) -> None:
    """What processes left that were killed while they wrote ``path``."""
    path = Path(path)
    for part in path.parent.glob(f".{glob.escape(path.name)}.*.part"):
        with suppress(OSError):
            part.unlink()


def _contiguous(arrays: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    return {name: np.ascontiguousarray(array) for name, array in arrays.items()}


def _check_arrays(path: str | Path, header: SceneHeader, arrays: dict[str, np.ndarray]) -> None:
    """Shapes that playback relies on."""
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
            raise found_instead(path, f"{name} of shape {found}", f"shape {shape} with at least one Gaussian")
    sh = arrays.get("sh")
    if sh is None or sh.ndim != 3 or sh.shape[0] != count or sh.shape[1] not in (1, 4, 9, 16) or sh.shape[2] != 3:
        raise found_instead(path, "no usable colours (sh)", f"shape ({count}, 1 | 4 | 9 | 16, 3)")
    if header.method not in METHODS:
        raise found_instead(path, f"the method {header.method!r}", f"one of {', '.join(METHODS)}")
    if header.frame_count < 1 or len(header.camera_shots) != len(header.cameras):
        raise found_instead(path, "a header without frames", "at least one, and for each camera what it saw")
