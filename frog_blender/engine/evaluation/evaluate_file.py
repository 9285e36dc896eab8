"""Evaluating a ``.frog`` file on a capture folder."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from ..capture.capture import Capture
from ..capture.readers import open_capture
from ..frames.store import FrameStore
from ..playback.player import ScenePlayer
from .as_trained import as_trained
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
    capture = open_capture(capture_path, pixel_offsets=header.pixel_offsets or None, masks=header.masks)
    return as_trained(header, capture)
