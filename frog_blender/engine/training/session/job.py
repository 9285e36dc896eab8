"""What to train: the settings of one training, and those that a resumed training takes over from its checkpoint."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from ...capture.camera import Camera
from ...capture.capture import Capture
from ...capture.masking import MaskSettings
from ...capture.seeds import Seeds
from ...field.names import METHODS
from ...io.plain_values import JsonMapping, JsonObject
from ...scene.scene_file import settings_json
from ..compression.settings import DEFAULT, CompressionSettings
from ..recipe import Recipe, recipe, stored_recipe
from ..setting import Choice, Kind, Name, Number, OrNone, check
from .live_scene import LiveScene

LARGEST_SIDE = 1600
"""Pixels a side, to which images are shrunk where no scale is chosen."""

_MAX_CAMERAS, _MAX_OFFSET = 10_000, 1e6


@dataclass(frozen=True)
class TrainingJob:
    """What to train.

    Attributes:
        capture: the capture's folder.
        output: the ``.frog`` to write; its checkpoint lies beside it.
        method: one of ``methods.METHODS``.
        recipe: the settings.
        steps, seconds: limits; the recipe's steps when neither is given.
        seed: of all random numbers.
        scale: image size factor; None shrinks to at most 1600 pixels a side.
        holdout_frames: hold out every n-th frame; None keeps what the format says.
        overwrite: replace a scene, or a checkpoint, that lies at ``output``; otherwise that is refused.
        resume: continue from the checkpoint beside ``output``, with the method, recipe and other settings that it
            began with; only ``steps``, ``seconds`` and ``max_bytes`` can be set anew.
        chosen: the settings that the user chose, by field, and what the user calls them (``--seed``): a resume names
            those that it ignores.
        pixel_offsets: see ``open_capture``.
        masks: "auto" trains on what masks and alpha leave of the images, "off" on all of them.
        key: a chroma key of all images, see ``masking.chroma_key``.
        lossless: write every number as it is; otherwise numbers are quantized where that is not visible.
        max_bytes: upper limit of the file's size; only with the recipe's capacity "auto".
        device: "auto", "cpu" or "cuda", see ``choose_device``; a resume may choose another.
        opened: the capture itself, where it is not what ``open_capture`` makes of the folder (a protocol's own
            split).
        seeds: the seed points, where they are known; None finds them in the images.
        event_seconds: between progress events, at least.
        evaluated_shots: images that each evaluation during the training looks at, at most.
        save_seconds: between checkpoints: the most that a killed training loses.
        preview_camera: whose view the previews show, see ``preview.preview_shot``.
        preview_size: pixels of a preview's longer side, at most: rendering 512 takes less than a step.
        preview_seconds: between previews, at most; there is one at every tenth of the training besides.
        compression: thresholds, with the recipe's capacity "auto".
        live: takes snapshots of the scene while it is trained; None makes none.
    """

    capture: Path
    output: Path
    method: str = "frog"
    recipe: Recipe = field(default_factory=lambda: recipe("standard"))
    steps: int | None = None
    seconds: float | None = None
    seed: int = 0
    scale: float | None = None
    holdout_frames: int | None = None
    overwrite: bool = True
    resume: bool = False
    chosen: Mapping[str, str] = field(default_factory=dict)
    pixel_offsets: dict[str, tuple[float, float]] | None = None
    masks: str = "auto"
    key: str | None = None
    device: str = "auto"
    lossless: bool = False
    max_bytes: int | None = None
    opened: Capture | None = None
    seeds: Seeds | None = None
    event_seconds: float = 0.5
    evaluated_shots: int = 6
    save_seconds: float = 180.0
    preview_camera: str | None = None
    preview_size: int = 512
    preview_seconds: float = 10.0
    compression: CompressionSettings = DEFAULT
    live: LiveScene | None = None

    @property
    def mask_settings(self) -> MaskSettings:
        """Of the masks and the key."""
        return MaskSettings(self.masks != "off", self.key)

    @classmethod
    def of_settings(cls, settings: JsonMapping, output: Path) -> TrainingJob:
        """The job of what ``stored_settings`` said, read from a file or a task.

        Raises:
            KeyError: a setting is missing.
            FrogError: one is not what it may be.
        """
        kept = restored_settings(settings)
        return cls(Path(str(settings["capture"])), output, **kept, recipe=stored_recipe(settings["recipe"]))

    def stored_settings(self) -> JsonObject:
        """JSON values for a checkpoint: the fields in ``RESUMED_SETTINGS``, the recipe, and whose training it is."""
        settings = {name: getattr(self, name) for name in RESUMED_SETTINGS}
        if self.pixel_offsets:
            settings["pixel_offsets"] = {name: list(offset) for name, offset in self.pixel_offsets.items()}
        return {**settings, "recipe": settings_json(self.recipe), "capture": str(Path(self.capture).resolve())}


def usual_scale(cameras: Iterable[Camera]) -> float:
    """The image size factor where none is chosen: at most LARGEST_SIDE pixels a side."""
    return min(1.0, LARGEST_SIDE / max(max(camera.width, camera.height) for camera in cameras))


@dataclass(frozen=True)
class _Offsets:
    """Pixels (x, y) by camera, as ``open_capture`` takes them."""

    expected = "two numbers of pixels for each camera"

    def accepts(self, value: object) -> bool:
        pixels = Number(-_MAX_OFFSET, _MAX_OFFSET)
        return (
            isinstance(value, dict)
            and len(value) <= _MAX_CAMERAS
            and all(isinstance(pair, list) and len(pair) == 2 for pair in value.values())
            and all(pixels.accepts(each) for pair in value.values() for each in pair)
        )


RESUMED_SETTINGS: dict[str, Kind] = {
    "method": Choice(tuple(METHODS)),
    "seed": Number(0, 2**32 - 1, whole=True),
    "scale": OrNone(Number(1e-4, 16)),
    "holdout_frames": OrNone(Number(0, 10**6, whole=True)),
    "pixel_offsets": OrNone(_Offsets()),
    "masks": Choice(("auto", "off")),
    "key": OrNone(Name()),
    "lossless": Choice((True, False)),
    "max_bytes": OrNone(Number(1, 2**50, whole=True)),
    "steps": OrNone(Number(1, 10**12, whole=True)),
    "seconds": OrNone(Number(1e-9, 1e12)),
}
"""Fields of a job that a resume takes over besides its recipe, and what a checkpoint may say of each."""


def restored_settings(stored: JsonMapping) -> dict[str, Any]:
    """The fields in ``RESUMED_SETTINGS`` of a job, checked; ``Any`` because fields have types of their own.

    Raises:
        KeyError: one is missing.
        FrogError: one is not what it may be.
    """
    kept = {name: stored[name] for name in RESUMED_SETTINGS}
    for name, value in kept.items():
        check(name, value, RESUMED_SETTINGS[name])
    if kept["pixel_offsets"]:
        kept["pixel_offsets"] = {name: (float(x), float(y)) for name, (x, y) in kept["pixel_offsets"].items()}
    return kept
