"""The public Python API: five functions and the types that they return. Import it as ``frog_blender.engine``."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from .capture.camera import Camera
from .capture.capture import Capture
from .capture.readers import open_capture as read_capture
from .errors import FrogError
from .evaluation.evaluate import (
    Figures,
    TrueImages,
    as_trained,
    evaluate_images,
    images_of,
    metrics_named,
    open_training_capture,
)
from .given_options import training_options
from .notices import say
from .options import OPTIONS
from .playback.player import ScenePlayer
from .playback.render import Drawing, draw
from .setting import Fitting, Number, OrNone, check, plain

if TYPE_CHECKING:
    from .training.session.events import Event

PathArgument = str | PathLike[str]


@dataclass(frozen=True)
class TrainResult:
    """What a training left.

    Attributes:
        path: the ``.frog`` file; None when it was cancelled before its first step.
        finished: False when it was cancelled. What was learned is in the file, and ``train(..., resume=True)`` goes on.
        steps: training steps done.
        seconds: of training, without decoding and saving; 0 when it was cancelled.
        num_gaussians: in the file; 0 when it was cancelled.
        psnr: dB on held-out images, or on training images where none are held out. None where it was not measured.
    """

    path: Path | None
    finished: bool
    steps: int
    seconds: float = 0.0
    num_gaussians: int = 0
    psnr: float | None = None


@dataclass(frozen=True)
class CameraMetrics:
    """Figures of some images.

    Attributes:
        psnr: dB, mean over the images.
        ssim: mean over the images, with the window of 3DGS.
        psnr_moving: dB over the pixels that change over time; None where nothing does, or the camera moves.
        images: how many there were.
        more: what ``metrics`` asked for, by name, means over the images.
    """

    psnr: float
    ssim: float
    psnr_moving: float | None
    images: int
    more: Mapping[str, float] = field(default_factory=dict, kw_only=True)


@dataclass(frozen=True)
class Metrics(CameraMetrics):
    """Figures of all images together.

    Attributes:
        split: "held-out" or "training".
        cameras: the same by camera.
    """

    split: str
    cameras: Mapping[str, CameraMetrics] = field(repr=False)


def _is_path(value: object) -> bool:
    return isinstance(value, str | PathLike)


def _is_list(value: object, holds: Callable[[object], bool], length: int | None = None) -> bool:
    """Whether it is a list, a tuple or an array of such values, and of that many."""
    parts = value.tolist() if isinstance(value, np.ndarray) else value
    if not isinstance(parts, list | tuple) or length not in (None, len(parts)):
        return False
    return all(holds(plain(part)) for part in parts)


def _is_text(value: object) -> bool:
    return isinstance(value, str)


_COLOR = Fitting(partial(_is_list, holds=Number(0, 1).accepts, length=3), "three numbers from 0 to 1")
_FUNCTION = Fitting(callable, "a function")
_NAMES = Fitting(partial(_is_list, holds=_is_text), "a list of names")
_ARGUMENTS = {
    "path": Fitting(_is_path, "a path"),
    "output": Fitting(_is_path, "a path"),
    "capture": Fitting(lambda value: _is_path(value) or isinstance(value, Capture), "an open capture, or its path"),
    "scene": Fitting(lambda value: isinstance(value, ScenePlayer), "a scene that load_scene has read"),
    "camera": Fitting(lambda value: isinstance(value, Camera), "a Camera, such as scene.header.cameras[0]"),
    "time": Number(0, 1),
    "background": OrNone(_COLOR),
    "split": Fitting(_is_text, "a word such as auto, held-out or training"),
    "mask": OrNone(Fitting(_is_path, "a path")),
    "metrics": _NAMES,
    "sinks": _NAMES,
    "on_event": OrNone(_FUNCTION),
    "on_progress": OrNone(_FUNCTION),
    "cancelled": _FUNCTION,
}
"""What the functions take besides the options of a training, by name."""


def _check(**values: object) -> None:
    """FrogError in one sentence for the first argument that is none of what it may be."""
    for name, value in values.items():
        check(name, plain(value), OPTIONS[name].kind if name in OPTIONS else _ARGUMENTS[name])


def open_capture(
    path: PathArgument, *, pixel_offsets: Mapping[str, tuple[float, float]] | None = None, layout: str = "auto"
) -> Capture:
    """Opens a folder of videos or images with cameras. Nothing is decoded yet.

    Args:
        path: the folder; docs/captures.md lists the layouts.
        pixel_offsets: by camera, the pixel (x, y) of its calibrated image at which a cropped video's corner lies.
        layout: what the names of images say, where they can be read in several ways; see ``train``.

    Raises:
        FrogError: if the folder is no capture, names in it can be read in several ways, or a value cannot be used.
    """
    _check(path=path, pixel_offsets=pixel_offsets, layout=layout)
    return read_capture(Path(path), pixel_offsets=plain(pixel_offsets), layout=layout)


def _with_options(function: Callable[..., TrainResult]) -> Callable[..., TrainResult]:
    """What ``help`` and editors show of ``train``: every option of the table in the place of ``**options``."""
    *own, _ = inspect.signature(function).parameters.values()
    keyword = inspect.Parameter.KEYWORD_ONLY
    shown = [inspect.Parameter(option.name, keyword, default=option.default) for option in OPTIONS.values()]
    function.__signature__ = inspect.Signature([*own[:2], *shown, *own[2:]])  # type: ignore[attr-defined]
    lines = [f"        {option.name}: {option.described}." for option in OPTIONS.values()]
    function.__doc__ = (function.__doc__ or "").replace("        OPTIONS", "\n".join(lines))
    return function


@_with_options
def train(
    capture: Capture | PathArgument,
    output: PathArgument,
    *,
    sinks: Sequence[str] = (),
    on_event: Callable[[Event], object] | None = None,
    cancelled: Callable[[], bool] = lambda: False,
    **options: Any,
) -> TrainResult:
    """Trains a scene from a capture and writes it as a ``.frog`` file. Imports torch.

    Args:
        capture: opened, or its folder.
        output: the ``.frog`` to write. Its checkpoint lies beside it.
        sinks: names of ``engine.registry.SINKS`` that are told every event.
        on_event: called with every event of ``engine.training.session.events``, in this thread.
        cancelled: asked between steps; True ends the training and keeps what was learned.
        OPTIONS

    Raises:
        FrogError: in one sentence, for what the caller can mend; for an argument before anything is decoded.
    """
    from .training.session import events
    from .training.session.job import TrainingJob
    from .training.session.run import run_training

    _check(capture=capture, output=output, sinks=sinks, on_event=on_event, cancelled=cancelled)
    chosen = training_options(options)
    opened = capture if isinstance(capture, Capture) else None
    for name in _OF_READING if opened else ():
        if name in options and getattr(chosen, name) != OPTIONS[name].default:
            raise FrogError(f"{name}: found a capture that is open already, expected its folder, which this changes.")
    folder = capture.path if isinstance(capture, Capture) else Path(capture)
    names = {name: name for name in (*options, *(chosen.settings or {}))}
    more = {"opened": opened, "chosen": names, "sinks": tuple(sinks)}
    job = TrainingJob.of_options(folder, Path(output), chosen, **more)
    result = TrainResult(None, False, 0)
    for event in run_training(job, cancelled):
        if on_event is not None:
            on_event(event)
        if isinstance(event, events.Finished):
            result = TrainResult(Path(event.path), True, event.steps, event.seconds, event.gaussians, event.psnr)
        elif isinstance(event, events.Cancelled):
            result = TrainResult(Path(event.path) if event.path else None, False, event.step)
    return result


_OF_READING = ("masks", "key", "pixel_offsets", "layout")
"""Options of how a folder is read."""


def load_scene(path: PathArgument) -> ScenePlayer:
    """Reads a ``.frog`` file, to be played: ``scene.at(time)`` gives the Gaussians at a time in [0, 1]. No torch.

    Raises:
        FrogError: if the file cannot be read, or is none.
    """
    _check(path=path)
    return ScenePlayer.load(Path(path))


def render(
    scene: ScenePlayer, camera: Camera, time: float = 0.0, *, background: tuple[float, float, float] | None = None
) -> Drawing:
    """What a camera sees of a scene at a time. No torch.

    Args:
        camera: one of ``scene.header.cameras``, or any other ``Camera`` in OpenCV's axes.
        time: in [0, 1] over the capture.
        background: display-referred sRGB in [0, 1]; None for the one that the scene was trained with.

    Returns:
        ``.rgb`` (H, W, 3) float32 display-referred sRGB, ``.alpha`` (H, W), and depths in world units.

    Raises:
        FrogError: for an argument of another type, or out of range.
    """
    _check(scene=scene, camera=camera, time=time, background=background)
    red, green, blue = scene.header.background if background is None else background
    drawing = draw(scene.at(float(time)), camera, (red, green, blue))
    say(drawing.notice)
    return drawing


def evaluate(
    scene: ScenePlayer,
    capture: Capture | PathArgument,
    *,
    split: str = "auto",
    mask: PathArgument | None = None,
    metrics: Sequence[str] = (),
    on_progress: Callable[[int, int], None] | None = None,
) -> Metrics:
    """Compares a scene with the images of the capture that it was trained on. No torch.

    Args:
        capture: opened at its own size, or its folder.
        split: "held-out" ("test", "val"), "training" ("train"), or "auto" for held-out images if there are any.
        mask: an image (white counts) or an ``.npz`` with a mask by camera, for ``psnr_moving``; None finds the pixels
            that change over time.
        metrics: names of further ones, of ``engine.registry.METRICS``.
        on_progress: called with the number of images that are done, and of all.

    Raises:
        FrogError: when it is another capture, or has no image of that split; for an argument before anything is
            decoded.
    """
    _check(scene=scene, capture=capture, split=split, mask=mask, metrics=metrics, on_progress=on_progress)
    if isinstance(capture, Capture):
        seen = as_trained(scene.header, capture)
    else:
        seen = open_training_capture(scene, Path(capture))
    more = metrics_named(metrics)
    images_of(split, scene, seen)  # what there is not is refused before minutes of decoding
    images = TrueImages(seen, None, Path(mask) if mask is not None else None)
    figures = evaluate_images(scene, images, split=split, more_metrics=more, progress=on_progress)
    cameras = {name: CameraMetrics(**_metrics(values, more)) for name, values in figures["cameras"].items()}
    return Metrics(**_metrics(figures, more), split=figures["split"], cameras=cameras)


def _metrics(figures: Figures, more: Iterable[str]) -> dict[str, Any]:
    plain = {name: figures[name] for name in ("psnr", "ssim", "psnr_moving")}
    return {**plain, "images": figures["frames"], "more": {name: figures[name] for name in more}}
