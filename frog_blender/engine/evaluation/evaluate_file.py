"""Evaluating a ``.frog`` file on a capture folder."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

from ..capture.camera import Camera
from ..capture.capture import Capture
from ..capture.frames import FrameStore
from ..capture.readers import open_capture
from ..errors import FrogError
from ..playback.player import ScenePlayer
from .evaluate import Figures, evaluate
from .metrics import Metric
from .perceptual import perceptual_metrics


def evaluate_file(
    scene_path: Path,
    capture_path: Path,
    *,
    split: str = "auto",
    mask_file: Path | None = None,
    perceptual: bool = False,
    progress: Callable[[int, int], None] | None = None,
) -> Figures:
    """Metrics of a scene file on the capture it was trained on; see ``evaluate``.

    Args:
        perceptual: "flip" and "lpips" as well. Where one cannot be computed it is None, and "missing" says why by name.

    Raises:
        FrogError: if a file cannot be read, or the capture is another one than that of the training.
    """
    scene = ScenePlayer.load(scene_path)
    capture = open_training_capture(scene, capture_path)
    metrics: dict[str, Metric] = {}
    missing: Figures = {}
    if perceptual:
        metrics, reasons = perceptual_metrics()
        missing = {**dict.fromkeys(reasons), "missing": reasons}
    figures = evaluate(
        scene,
        capture,
        FrameStore.open(capture),
        split=split,
        mask_file=mask_file,
        file_bytes=scene_path.stat().st_size,
        more_metrics=metrics,
        progress=progress,
    )
    return {**figures, **missing}


def open_training_capture(scene: ScenePlayer, capture_path: Path) -> Capture:
    """The capture as the training of a scene saw it: the same image size, pixel offsets and refined poses.

    Raises:
        FrogError: if it cannot be read, or has other cameras or frames than the scene.
    """
    header = scene.header
    capture = open_capture(capture_path, pixel_offsets=header.pixel_offsets or None)
    if header.scale != 1.0:
        capture = capture.scaled(header.scale)
    for found, expected in _in_common(capture.cameras, capture.frame_count, header.cameras, header.frame_count):
        if found != expected:
            raise FrogError(f"{capture_path}: found {found}, expected {expected} as the scene was trained on.")
    return capture.with_cameras(header.cameras)


def _in_common(
    cameras: Sequence[Camera], frames: int, trained: Sequence[Camera], trained_frames: int
) -> Iterator[tuple[str, str]]:
    """What a capture and a scene must have in common: as the capture has it, and as the scene has it."""
    yield f"{len(cameras)} cameras and {frames} frames", f"{len(trained)} cameras and {trained_frames} frames"
    for camera, own in zip(cameras, trained, strict=True):
        yield (
            f"camera {camera.name} of {camera.width} x {camera.height} pixels",
            f"camera {own.name} of {own.width} x {own.height} pixels",
        )
