"""The quality of a finished scene, measured on images of the capture it was trained on. No torch."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, SupportsFloat

import numpy as np

from ..capture.capture import Capture, Shot
from ..capture.readers import open_capture
from ..errors import FrogError
from ..frames.store import FrameStore
from ..notices import say
from ..playback.player import ScenePlayer
from ..playback.render import draw
from ..registry import METRICS
from ..scene.header import SceneHeader
from .masks import Mask, load_masks, moving_mask
from .metrics import Image, Metric, gradient_energy, psnr_of, ssim
from .perceptual import perceptual_metrics


def as_trained(header: SceneHeader, capture: Capture) -> Capture:
    """The capture at the image size that a scene was trained on, with the scene's own cameras.

    Args:
        capture: opened with ``header.pixel_offsets``, at its own size.

    Raises:
        FrogError: when it is another capture than the scene's.
    """
    sized = capture.scaled(header.scale)
    for found, expected in _facts(sized, header):
        if found != expected:
            raise FrogError(f"{capture.path}: found {found}, expected {expected} as the scene was trained on.")
    return sized.with_cameras(header.cameras)


def _facts(capture: Capture, header: SceneHeader) -> Iterator[tuple[str, str]]:
    """What both must have in common: of the capture, and of the scene."""
    yield (
        f"{len(capture.cameras)} cameras and {capture.frame_count} frames",
        f"{len(header.cameras)} cameras and {header.frame_count} frames",
    )
    for camera, own in zip(capture.cameras, header.cameras, strict=True):
        yield (
            f"camera {camera.name} of {camera.width} x {camera.height} pixels",
            f"camera {own.name} of {own.width} x {own.height} pixels",
        )


ALWAYS = ("psnr", "ssim")
"""Metrics that every evaluation has."""
_FIGURES = frozenset(
    {"psnr_moving", "psnr_inside", "sharpness_moving", "frames", "split", "method", "gaussians", "bytes", "cameras"}
    | {"steps", "train_seconds", "missing"}
)
Figures = dict[str, Any]
"""Metrics by name, as JSON has them: numbers, None, names, and such dictionaries by camera (hence the Any)."""


def evaluate_images(
    scene: ScenePlayer,
    capture: Capture,
    store: FrameStore,
    *,
    split: str = "auto",
    mask_file: Path | None = None,
    file_bytes: int = 0,
    more_metrics: Mapping[str, Metric] | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> Figures:
    """Metrics over all cameras and, below "cameras", for each camera.

    "psnr" (dB) and "ssim" are means over images. "psnr_moving" (dB) comes from the mean squared error over the masked
    pixels of all images, and "sharpness_moving" is the gradient energy in them relative to that of the true images.
    "psnr_inside" (dB) is that of the subject's pixels where images have alpha or masks, whose other pixels lie over the
    scene's background. What is to be ignored counts nowhere.

    Args:
        capture: with the cameras as the scene was trained with them.
        split: "held-out", "training", or "auto": held-out images if there are any.
        mask_file: see ``load_masks``. Without one the mask is ``moving_mask``, which a moving camera does not have.
        file_bytes: size of the scene's file, reported as "bytes".
        more_metrics: further metrics by name, reported as means over images (see ``metrics_named``).
        progress: called with the number of images done and of all.

    Raises:
        FrogError: if the split has no images, or the mask file does not fit the capture.
    """
    chosen, split = _images_of(split, scene, capture)
    masks = _Masks(capture, store, load_masks(mask_file, capture) if mask_file else None)
    sums: dict[str, _Sums] = {}
    for done, index in enumerate(chosen):
        shot = capture.shots[index]
        camera = capture.cameras[shot.camera]
        truth = store.image(index).astype(np.float32) / 255
        drawing = draw(scene.at(capture.time_of(shot)), camera, scene.header.background)
        say(drawing.notice)
        image, counted = drawing.rgb.clip(0, 1), _counted(capture, store, index)
        if counted is not None:
            image = np.where(counted[..., None], image, truth)
        part, subject = sums.setdefault(camera.name, _Sums()), _subject(capture, store, index)
        part.add(image, truth, _both(masks.of(shot), counted), more_metrics or {}, counted=counted)
        part.add_subject(image, truth, _both(subject, counted))
        if progress:
            progress(done + 1, len(chosen))
    return {
        **_figures(list(sums.values())),
        "split": split,
        "method": scene.header.method,
        "gaussians": scene.count,
        "bytes": file_bytes,
        "steps": scene.header.steps,
        "train_seconds": scene.header.train_seconds,
        "cameras": {name: _figures([part]) for name, part in sums.items()},
    }


def metrics_named(names: Iterable[str]) -> dict[str, Metric]:
    """Further metrics, of ``registry.METRICS``.

    Raises:
        FrogError: for a name that there is not, or that a figure of ours has.
    """
    metrics = {name: METRICS[name] for name in names if name not in ALWAYS}
    for name in metrics:
        if name in _FIGURES:
            raise FrogError(f"The metric {name!r} has the name of a figure of every evaluation, expected another name.")
    return metrics


def _number(name: str, value: object) -> float:
    """What a metric gave; FrogError where it is no number."""
    if np.ndim(value) or not isinstance(value, SupportsFloat):  # type: ignore[arg-type]  # it may be anything
        raise FrogError(f"The metric {name!r} gave {type(value).__name__}, expected one number for an image.")
    return float(value)


def held_out_shots(scene: ScenePlayer, capture: Capture) -> list[int]:
    """Indices into ``capture.shots`` of the images that the scene was not trained on."""
    names = [camera.name for camera in capture.cameras]
    return [i for i, shot in enumerate(capture.shots) if scene.header.is_test(names[shot.camera], shot.frame)]


def _images_of(split: str, scene: ScenePlayer, capture: Capture) -> tuple[list[int], str]:
    """Indices into ``capture.shots`` of a split, and its name; FrogError where it has no image."""
    held_out = held_out_shots(scene, capture)
    if split == "auto":
        split = "held-out" if held_out else "training"
    chosen = held_out if split == "held-out" else sorted(set(range(len(capture.shots))) - set(held_out))
    if not chosen:
        raise FrogError(f"{capture.path}: there is no {split} image to evaluate on.")
    return chosen, split


def _counted(capture: Capture, store: FrameStore, index: int) -> Mask | None:
    """(H, W) what is not to be ignored of an image; None where all counts."""
    ignored = store.ignored(index) if capture.has_masks else None
    return None if ignored is None or not ignored.any() or ignored.all() else ignored == 0


def _subject(capture: Capture, store: FrameStore, index: int) -> Mask | None:
    """(H, W) pixels of an image that are the subject's for the most part; None where images are whole."""
    alpha = store.alpha(index) if capture.has_masks else None
    return None if alpha is None else alpha > 127


def _both(mask: Mask | None, counted: Mask | None) -> Mask | None:
    return mask if mask is None or counted is None else mask & counted


class _Masks:
    """The mask of each image: from a file, or else ``moving_mask`` of its camera, found when it is first needed."""

    def __init__(self, capture: Capture, store: FrameStore, given: Mapping[str, Mask] | None) -> None:
        self._capture, self._store, self._given = capture, store, given
        self._found: dict[int, Mask | None] = {}

    def of(self, shot: Shot) -> Mask | None:
        """(H, W), or None where the camera has no mask."""
        if self._given is not None:
            mask = self._given.get(self._capture.cameras[shot.camera].name)
            return mask if mask is None or mask.ndim == 2 else mask[min(shot.frame, len(mask) - 1)]
        if shot.camera not in self._found:
            indices = [i for i, other in enumerate(self._capture.shots) if other.camera == shot.camera]
            self._found[shot.camera] = moving_mask(self._store, indices) if len(indices) > 1 else None
        return self._found[shot.camera]


@dataclass
class _Sums:
    """Running sums over the images of one camera."""

    psnr: float = 0.0
    ssim: float = 0.0
    frames: int = 0
    masked_error: float = 0.0
    masked_count: int = 0
    sharpness: float = 0.0
    true_sharpness: float = 0.0
    inside_error: float = 0.0
    inside_count: int = 0
    more: dict[str, float] = field(default_factory=dict)

    def add(
        self,
        image: Image,
        truth: Image,
        mask: Mask | None,
        more_metrics: Mapping[str, Metric],
        *,
        counted: Mask | None = None,
    ) -> None:
        """An image and its ground truth, both (H, W, 3) in [0, 1], equal where pixels are not ``counted`` (H, W)."""
        error = (image.astype(np.float64) - truth) ** 2
        self.psnr += psnr_of(float(error.mean() if counted is None else error[counted].mean()))
        self.ssim += ssim(image, truth)
        for name, metric in more_metrics.items():
            self.more[name] = self.more.get(name, 0.0) + _number(name, metric(image, truth))
        self.frames += 1
        if mask is not None and mask.any():
            self.masked_error += float(error[mask].mean(axis=1).sum())
            self.masked_count += int(mask.sum())
            self.sharpness += gradient_energy(image, mask)
            self.true_sharpness += gradient_energy(truth, mask)

    def add_subject(self, image: Image, truth: Image, mask: Mask | None) -> None:
        """The pixels (H, W) of its subject, besides."""
        if mask is not None:
            error = (image[mask].astype(np.float64) - truth[mask]) ** 2
            self.inside_error += float(error.mean(axis=1).sum())
            self.inside_count += int(mask.sum())


def _figures(parts: Sequence[_Sums]) -> Figures:
    """Metrics over the images of some cameras."""
    frames, count = sum(p.frames for p in parts), sum(p.masked_count for p in parts)
    true_sharpness = sum(p.true_sharpness for p in parts)
    inside = sum(p.inside_count for p in parts)
    return {
        "psnr": sum(p.psnr for p in parts) / frames,
        "psnr_moving": psnr_of(sum(p.masked_error for p in parts) / count) if count else None,
        **({"psnr_inside": psnr_of(sum(p.inside_error for p in parts) / inside)} if inside else {}),
        "ssim": sum(p.ssim for p in parts) / frames,
        **{name: sum(p.more[name] for p in parts) / frames for name in parts[0].more},
        "sharpness_moving": sum(p.sharpness for p in parts) / true_sharpness if true_sharpness else None,
        "frames": frames,
    }


def evaluate_file(
    scene_path: Path,
    capture_path: Path,
    *,
    split: str = "auto",
    mask_file: Path | None = None,
    perceptual: bool = False,
    metrics: Sequence[str] = (),
    progress: Callable[[int, int], None] | None = None,
) -> Figures:
    """Metrics of a scene file on the capture it was trained on; see ``evaluate_images``.

    Args:
        perceptual: "flip" and "lpips" as well. Where one cannot be computed it is None, and "missing" says why by name.
        metrics: names of further ones, see ``registry.METRICS``.

    Raises:
        FrogError: if a file cannot be read, or the capture is another one than that of the training.
    """
    scene = ScenePlayer.load(scene_path)
    capture = open_training_capture(scene, capture_path)
    more, missing = metrics_named(metrics), Figures()
    if perceptual:
        installed, reasons = perceptual_metrics()
        more |= installed
        missing = {**dict.fromkeys(reasons), "missing": reasons}
    figures = evaluate_images(
        scene,
        capture,
        FrameStore.open(capture),
        split=split,
        mask_file=mask_file,
        file_bytes=scene_path.stat().st_size,
        more_metrics=more,
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
