"""What a scene file says of itself, and the one place that checks it before anything is made of it."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from types import MappingProxyType
from typing import Any

from ..capture.camera import Camera, cameras_move
from ..capture.masking import EVERY_MASK, MaskSettings
from ..capture.world import FILES_OWN, World
from ..errors import FrogError
from ..field.names import SEQUENCE
from ..gaussians import LOW_PASS, WIDEST_LOW_PASS
from ..io import plain_values
from ..io.plain_values import JsonMapping, UnfitValue, entries
from ..io.tensor_files import LONGEST_HEADER
from ..registry import METHODS
from .compression_report import readable_report

FORMAT_VERSION = 1

MAX_FRAMES = 1_048_574
"""Of a capture: where Blender's timeline ends, ten hours of film."""
MOST_CAMERAS = 65_536
"""Of a scene. A moving camera is one for each of its images."""
MOST_STANDING = 4096
"""Of those, where they are no moving camera's: each becomes an object in Blender."""
_LONGEST_NAME, _LONGEST_PATH = 1024, 32_768  # characters
_FASTEST = 1e6  # frames a second
_MOST_SHOTS = LONGEST_HEADER // 12  # of all cameras: each is up to nine characters
_USUAL: JsonMapping = {
    "world": FILES_OWN,
    "masks": EVERY_MASK,
    "layout": "auto",
    "made_of": {},
    "low_pass": LOW_PASS,
}
"""Fields that plain scenes leave out."""


@dataclass(frozen=True)
class SceneHeader:
    """What a scene file says of itself.

    Attributes:
        method: a name of ``registry.METHODS``, or SEQUENCE.
        recipe: every setting of the training, as plain values.
        model: the model's settings (see FrogSettings), empty for a scene in which nothing moves.
        cameras: the capture's cameras at the size they were trained at; none for splats from elsewhere.
        camera_shots: for each camera the frames it saw; one frame each for a moving camera.
        test_cameras, test_frames: what training did not see.
        frame_count, frames_per_second: the capture's time axis; frame f has time f / (frame_count - 1).
        background: display-referred colour behind the Gaussians.
        capture_path, capture_format, scale, pixel_offsets: where the frames came from and how they were read.
        metrics: PSNR and so on as measured at the end of training.
        steps: how much training is in it. How long it took is in its checkpoint: equal trainings make equal files.
        capacity: what the training took out of the model (see training.compression), empty where it took nothing.
        world: where the scene's coordinates lie in those of the capture's files.
        masks: what was made of the capture's masks.
        layout: what the user said of the names of the capture's images.
        made_of: see ``frame_keys.made_of``; empty where nothing is known.
        low_pass: that it was trained with, see GaussianArrays.
    """

    method: str
    recipe: JsonMapping
    model: JsonMapping
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
    pixel_offsets: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    metrics: JsonMapping = field(default_factory=dict)
    steps: int = 0
    capacity: JsonMapping = field(default_factory=dict)
    world: World = FILES_OWN
    masks: MaskSettings = EVERY_MASK
    layout: str = "auto"
    made_of: JsonMapping = field(default_factory=dict)
    low_pass: float = LOW_PASS

    def __post_init__(self) -> None:
        """Copies the mappings, and lets nobody change the copies: a header says what it said when it was made."""
        for name in ("recipe", "model", "pixel_offsets", "metrics", "capacity", "made_of"):
            object.__setattr__(self, name, MappingProxyType(dict(getattr(self, name))))

    @property
    def is_moving(self) -> bool:
        """One moving camera: every entry of ``cameras`` is one frame of it, or a held-out image."""
        trained = [
            frame
            for camera, frames in zip(self.cameras, self.camera_shots, strict=True)
            for frame in frames
            if not self.is_test(camera.name, frame)
        ]
        return self.frame_count > 1 and cameras_move(map(len, self.camera_shots), trained)

    def is_test(self, camera_name: str, frame: int) -> bool:
        """True for an image that training did not see."""
        return camera_name in self.test_cameras or frame in self.test_frames

    def to_json(self) -> str:
        own = {name: value for name, value in vars(self).items() if name not in _USUAL or value != _USUAL[name]}
        last = own.pop("cameras")
        return json.dumps({"format_version": FORMAT_VERSION, **own, "cameras": last}, default=_plain, allow_nan=False)

    @classmethod
    def from_json(cls, content: str) -> SceneHeader:
        """Raises UnfitValue for a header that nobody could play, draw or import."""
        data = entries(plain_values.plain_json(content, "a header"), "a header")
        version = plain_values.whole(data.get("format_version"), "format_version", 0, 2**31)
        if version != FORMAT_VERSION:
            raise UnfitValue(f"format version {version}", f"version {FORMAT_VERSION}")
        missing = [name for name in _READERS if name not in data and name not in _USUAL]
        if missing:
            raise UnfitValue(f"a header without {', '.join(missing)}", "all that a scene needs")
        header = cls(**{name: read(data[name], name) for name, read in _READERS.items() if name in data})
        if len(header.camera_shots) != len(header.cameras):
            said = f"{len(header.camera_shots)} camera_shots of {len(header.cameras)} cameras"
            raise UnfitValue(said, "what each of them saw")
        if len(header.cameras) > MOST_STANDING and not header.is_moving:
            raise UnfitValue(f"{len(header.cameras)} cameras that do not move", f"at most {MOST_STANDING}")
        return header


def _plain(value: Any) -> Any:
    """What JSON has not: mappings, masks, and what writes itself."""
    if isinstance(value, MappingProxyType | MaskSettings):
        return dict(value) if isinstance(value, MappingProxyType) else vars(value)
    return value.to_json()


def _method(value: object, what: str) -> str:
    method = plain_values.text(value, what, _LONGEST_NAME)
    if method != SEQUENCE and method not in METHODS:
        raise UnfitValue(f"the method {method!r}", f"one of {', '.join(METHODS)}, or the package that has it")
    return method


def _frames(value: object, what: str) -> tuple[int, ...]:
    return tuple(
        plain_values.whole(frame, f"a frame of {what}", 0, MAX_FRAMES - 1)
        for frame in plain_values.items(value, what, MAX_FRAMES)
    )


def _offsets(value: object, what: str) -> dict[str, tuple[float, float]]:
    return {
        plain_values.text(name, "a camera's name", _LONGEST_NAME): tuple(
            plain_values.numbers(offset, "a pixel offset", (2,), 1e6).tolist()
        )
        for name, offset in entries(value, what).items()
    }


def _each(value: object, what: str, read: Callable[[Any, str], Any]) -> tuple[Any, ...]:
    """What is read of each value of a list of as many as there may be cameras."""
    return tuple(read(item, what) for item in plain_values.items(value, what, MOST_CAMERAS))


_READERS: dict[str, Callable[[Any, str], Any]] = {
    "method": _method,
    "recipe": plain_values.finite_entries,
    "model": plain_values.finite_entries,
    "cameras": partial(_each, read=lambda value, _: Camera.from_json(value)),
    "camera_shots": partial(_each, read=_frames),
    "test_cameras": partial(_each, read=partial(plain_values.text, longest=_LONGEST_NAME)),
    "test_frames": _frames,
    "frame_count": partial(plain_values.whole, least=1, most=MAX_FRAMES),
    "frames_per_second": partial(plain_values.number, least=1e-6, most=_FASTEST),
    "background": lambda value, what: tuple(plain_values.numbers(value, what, (3,), 1e3).tolist()),
    "capture_path": partial(plain_values.text, longest=_LONGEST_PATH),
    "capture_format": partial(plain_values.text, longest=_LONGEST_NAME),
    "scale": partial(plain_values.number, least=1e-6, most=1e6),
    "pixel_offsets": _offsets,
    "metrics": plain_values.finite_entries,
    "steps": partial(plain_values.whole, least=0, most=2**62),
    "capacity": lambda value, _: readable_report(value),
    "world": lambda value, _: World.from_json(value),
    "masks": lambda value, what: plain_values.typed(MaskSettings, vars(EVERY_MASK) | entries(value, what), what),
    "layout": partial(plain_values.text, longest=_LONGEST_NAME),
    "made_of": plain_values.finite_entries,
    "low_pass": partial(plain_values.number, least=0, most=WIDEST_LOW_PASS),
}
"""What checks and makes each field of plain values: UnfitValue for what it cannot be."""


def check_readable(file: Path, header: SceneHeader) -> None:
    """FrogError for a header that could be written but not read again; ``file`` is what a scene is made of."""
    try:
        shots = sum(map(len, header.camera_shots))
        if shots > _MOST_SHOTS:
            raise UnfitValue(f"{shots:,} frames of all cameras", f"at most {_MOST_SHOTS:,}")
        size = len(json.dumps(content := header.to_json()))
        if size > LONGEST_HEADER * 3 // 4:  # the rest is for how the arrays are packed
            raise UnfitValue(f"cameras that take {size:,} bytes", "fewer, or shorter names")
        SceneHeader.from_json(content)
    except ValueError as error:
        raise FrogError(f"{file}: no scene of it could be opened: found {error}.") from error
