"""What a scene file says of itself, and the one place that checks it before anything is made of it."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from types import MappingProxyType

from ..capture.camera import Camera, cameras_move
from ..capture.masking import EVERY_MASK, MaskSettings
from ..capture.world import FILES_OWN, World
from ..errors import brief
from ..field.names import SEQUENCE
from ..io.plain_values import (
    JsonMapping,
    JsonObject,
    UnfitValue,
    entries,
    finite_entries,
    items,
    number,
    numbers,
    plain_json,
    text,
    whole,
)
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
_OPTIONAL = ("world", "masks")  # fields that plain scenes leave out
_OBJECTS = ("cameras", *_OPTIONAL)  # fields that write themselves


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
        steps, train_seconds: how much training is in it (decoding and seeding not counted).
        capacity: what the training took out of the model (see training.compression), empty where it took nothing.
        world: where the scene's coordinates lie in those of the capture's files.
        masks: what was made of the capture's masks.
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
    train_seconds: float = 0.0
    capacity: JsonMapping = field(default_factory=dict)
    world: World = FILES_OWN
    masks: MaskSettings = EVERY_MASK

    def __post_init__(self) -> None:
        """Copies the mappings, and lets nobody change the copies: a header says what it said when it was made."""
        for name in ("recipe", "model", "pixel_offsets", "metrics", "capacity"):
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
        values: JsonObject = {"format_version": FORMAT_VERSION}
        values |= {name: getattr(self, name) for name in self.__dataclass_fields__ if name not in _OBJECTS}
        values = {name: dict(value) if isinstance(value, MappingProxyType) else value for name, value in values.items()}
        world = {} if self.world.is_plain else {"world": self.world.to_json()}
        masks = {} if self.masks == EVERY_MASK else {"masks": {"use": self.masks.use, "key": self.masks.key}}
        return json.dumps({**values, **world, **masks, "cameras": [c.to_json() for c in self.cameras]}, allow_nan=False)

    @classmethod
    def from_json(cls, content: str) -> SceneHeader:
        """Raises UnfitValue for a header that nobody could play, draw or import."""
        data = entries(plain_json(content, "a header"), "a header")
        version = whole(data.get("format_version"), "format_version", 0, 2**31)
        if version != FORMAT_VERSION:
            raise UnfitValue(f"format version {version}", f"version {FORMAT_VERSION}")
        missing = [name for name in cls.__dataclass_fields__ if name not in data and name not in _OPTIONAL]
        if missing:
            raise UnfitValue(f"a header without {', '.join(missing)}", "all that a scene needs")
        method = text(data["method"], "the method", _LONGEST_NAME)
        if method != SEQUENCE and method not in METHODS:
            raise UnfitValue(f"the method {method!r}", f"one of {', '.join(METHODS)}, or the package that has it")
        red, green, blue = numbers(data["background"], "background", (3,), 1e3).tolist()
        header = cls(
            method=method,
            recipe=finite_entries(data["recipe"], "recipe"),
            model=finite_entries(data["model"], "model"),
            **_filmed(data),
            frames_per_second=number(data["frames_per_second"], "frames_per_second", 1e-6, _FASTEST),
            background=(red, green, blue),
            capture_path=text(data["capture_path"], "capture_path", _LONGEST_PATH),
            capture_format=text(data["capture_format"], "capture_format", _LONGEST_NAME),
            scale=number(data["scale"], "scale", 1e-6, 1e6),
            pixel_offsets=_offsets(data["pixel_offsets"]),
            metrics=finite_entries(data["metrics"], "metrics"),
            steps=whole(data["steps"], "steps", 0, 2**62),
            train_seconds=number(data["train_seconds"], "train_seconds", 0, 1e15),
            capacity=readable_report(data["capacity"]),
            world=World.from_json(data["world"]) if "world" in data else FILES_OWN,
            masks=_masks(data["masks"]) if "masks" in data else EVERY_MASK,
        )
        if len(header.cameras) > MOST_STANDING and not header.is_moving:
            raise UnfitValue(f"{len(header.cameras)} cameras that do not move", f"at most {MOST_STANDING}")
        return header


def _masks(value: object) -> MaskSettings:
    found = {"use": True, "key": None} | entries(value, "masks")
    key = None if found["key"] is None else text(found["key"], "the chroma key", 100)
    if not isinstance(found["use"], bool):
        raise UnfitValue(f"use of masks = {brief(found['use'])}", "true or false")
    return MaskSettings(found["use"], key)


def _filmed(data: JsonObject) -> JsonObject:
    """The fields that say which cameras saw which frames."""
    cameras = tuple(Camera.from_json(camera) for camera in items(data["cameras"], "cameras", MOST_CAMERAS))
    shots = items(data["camera_shots"], "camera_shots", MOST_CAMERAS)
    if len(shots) != len(cameras):
        raise UnfitValue(f"{len(shots)} camera_shots of {len(cameras)} cameras", "what each of them saw")
    return {
        "cameras": cameras,
        "camera_shots": tuple(_frames(seen, "camera_shots") for seen in shots),
        "test_cameras": tuple(
            text(name, "test_cameras", _LONGEST_NAME)
            for name in items(data["test_cameras"], "test_cameras", MOST_CAMERAS)
        ),
        "test_frames": _frames(data["test_frames"], "test_frames"),
        "frame_count": whole(data["frame_count"], "frame_count", 1, MAX_FRAMES),
    }


def _frames(value: object, what: str) -> tuple[int, ...]:
    return tuple(whole(frame, f"a frame of {what}", 0, MAX_FRAMES - 1) for frame in items(value, what, MAX_FRAMES))


def _offsets(value: object) -> dict[str, tuple[float, float]]:
    found = {}
    for name, offset in entries(value, "pixel_offsets").items():
        dx, dy = numbers(offset, "a pixel offset", (2,), 1e6).tolist()
        found[text(name, "a camera's name", _LONGEST_NAME)] = (dx, dy)
    return found
