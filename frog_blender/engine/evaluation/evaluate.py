"""The quality of a finished scene, measured on images of the capture it was trained on. No torch."""

from collections import defaultdict
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, SupportsFloat

import numpy as np

from ..capture.camera import Camera
from ..capture.capture import Capture
from ..capture.frame_keys import found_otherwise
from ..capture.readers import open_capture
from ..errors import FrogError, UsageError, brief, found_instead
from ..frames.store import FrameStore
from ..notices import say
from ..playback.player import ScenePlayer
from ..playback.render import draw
from ..registry import METRICS, guests_named
from ..scene.header import SceneHeader
from .masks import Mask, load_masks, moving_mask
from .metrics import SPLITS, Image, Metric, gradient_energy, psnr_of, ssim

_FARTHEST, _LEAST_COSINE = 0.25, 0.97  # of a pose: a quarter of the rig's radius, and 14 degrees


def as_trained(header: SceneHeader, capture: Capture) -> Capture:
    """The capture at the image size that a scene was trained on, with the scene's own cameras.

    A capture that is not as it was, as far as the scene knows it, is told of.

    Args:
        capture: opened with ``header.pixel_offsets``, at its own size.

    Raises:
        FrogError: when it is another capture than the scene's.
    """
    sized = capture.scaled(header.scale)
    for own, expected in zip(_facts(sized), _facts(header), strict=True):
        if own != expected:
            raise FrogError(f"{capture.path}: found {own}, expected {expected} as the scene was trained on.")
    unlike = found_otherwise(header.made_of, sized)
    if (displaced := _displaced(header.cameras, sized.cameras)) and ("images" in unlike or not header.made_of):
        expected = f"its pose in {header.capture_path}, which the scene was trained on"
        raise found_instead(capture.path, f"camera {displaced} placed otherwise", expected)
    if unlike:
        found, trained_on = " and ".join(unlike.values()), header.capture_path
        say(f"{capture.path}: found {found} than the scene was trained on ({trained_on}); it is compared with these.")
    return sized.with_cameras(header.cameras)


def _facts(filmed: Capture | SceneHeader) -> Iterator[str]:
    """What a capture and a scene of it have in common."""
    yield f"{len(filmed.cameras)} cameras and {filmed.frame_count} frames"
    for camera in filmed.cameras:
        yield f"camera {camera.name} of {camera.width} x {camera.height} pixels"


def _displaced(known: Sequence[Camera], cameras: Sequence[Camera]) -> str:
    """The name of the first camera whose pose is much further from a scene's than refinement takes it; "" for none."""
    centers = np.array([camera.center for camera in known])
    spread = np.linalg.norm(centers - centers.mean(axis=0), axis=1).max(initial=0.0)
    for camera, other in zip(known, cameras, strict=True):
        cosine = (np.trace(camera.rotation @ other.rotation.T) - 1) / 2
        is_far = spread > 0 and np.linalg.norm(camera.center - other.center) > _FARTHEST * spread
        if is_far or cosine < _LEAST_COSINE:
            return camera.name
    return ""


ALWAYS = ("psnr", "ssim")
"""Metrics that every evaluation has."""
_FIGURES = frozenset(
    {"psnr_moving", "psnr_inside", "sharpness_moving", "frames", "split", "method", "gaussians", "bytes", "cameras"}
    | {"steps", "missing"}
)
Figures = dict[str, Any]
"""Metrics by name, as JSON has them: numbers, None, names, and such dictionaries by camera (hence the Any)."""


class TrueImages:
    """What the drawings of a scene are compared with.

    Args:
        capture: with the cameras as the scene was trained with them.
        store: its images; None opens them, once the mask file is known to fit.
        mask_file: see ``load_masks``. Without one the mask is ``moving_mask``, which a moving camera does not have.

    Raises:
        FrogError: if the mask file does not fit the capture.
    """

    def __init__(self, capture: Capture, store: FrameStore | None, mask_file: Path | None = None) -> None:
        self._given = load_masks(mask_file, capture) if mask_file else None
        self.capture, self._store = capture, store or FrameStore.open(capture)
        self._found: dict[int, Mask | None] = {}

    def image(self, index: int) -> Image:
        """(H, W, 3) of a shot."""
        return self._store.image(index).astype(np.float32) / 255

    def counted(self, index: int) -> Mask | None:
        """(H, W) what is not to be ignored of a shot; None where all counts."""
        ignored = self._store.ignored(index) if self.capture.has_masks else None
        return None if ignored is None or not ignored.any() or ignored.all() else ignored == 0

    def subject(self, index: int) -> Mask | None:
        """(H, W) pixels of a shot that are the subject's for the most part; None where images are whole."""
        alpha = self._store.alpha(index) if self.capture.has_masks else None
        return None if alpha is None else alpha > 127

    def moving(self, index: int) -> Mask | None:
        """(H, W) the mask of a shot: from the file, or ``moving_mask``, found when it is first needed; None where its
        camera has none."""
        shot = self.capture.shots[index]
        if self._given is not None:
            mask = self._given.get(self.capture.cameras[shot.camera].name)
            return mask if mask is None or mask.ndim == 2 else mask[min(shot.frame, len(mask) - 1)]
        if shot.camera not in self._found:
            indices = [i for i, other in enumerate(self.capture.shots) if other.camera == shot.camera]
            self._found[shot.camera] = moving_mask(self._store, indices) if len(indices) > 1 else None
        return self._found[shot.camera]


@guests_named()
def evaluate_images(
    scene: ScenePlayer,
    images: TrueImages,
    *,
    split: str = "auto",
    more_metrics: Mapping[str, Metric] | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> Figures:
    """Metrics over all cameras and, below "cameras", for each camera.

    "psnr" (dB) and "ssim" are means over images. "psnr_moving" (dB) comes from the mean squared error over the masked
    pixels of all images, and "sharpness_moving" is the gradient energy in them relative to that of the true images.
    "psnr_inside" (dB) is that of the subject's pixels where images have alpha or masks, whose other pixels lie over the
    scene's background. What is to be ignored counts nowhere.

    Args:
        split: a word of ``SPLITS``, or "auto": held-out images if there are any.
        more_metrics: further metrics by name, reported as means over images (see ``metrics_named``).
        progress: called with the number of images done and of all.

    Raises:
        FrogError: if the split has no images, or another name.
    """
    capture, more = images.capture, more_metrics or {}
    chosen, split = images_of(split, scene, capture)
    sums: dict[str, _Sums] = {}
    for done, index in enumerate(chosen):
        shot = capture.shots[index]
        camera = capture.cameras[shot.camera]
        truth, counted = images.image(index), images.counted(index)
        drawing = draw(scene.at(capture.time_of(shot)), camera, scene.header.background)
        say(drawing.notice)
        image = drawing.rgb.clip(0, 1)
        if counted is not None:
            image = np.where(counted[..., None], image, truth)
        of_camera, moving = sums.setdefault(camera.name, defaultdict(int)), _both(images.moving(index), counted)
        of_camera["frames"] += 1
        error = (image.astype(np.float64) - truth) ** 2
        of_camera["psnr"] += psnr_of(float(error.mean() if counted is None else error[counted].mean()))
        of_camera["ssim"] += ssim(image, truth)
        for name, metric in more.items():
            of_camera[name] += _number(name, metric(image, truth))
        if moving is not None and moving.any():
            of_camera["sharpness"] += gradient_energy(image, moving)
            of_camera["true sharpness"] += gradient_energy(truth, moving)
        for part, mask in (("moving", moving), ("inside", _both(images.subject(index), counted))):
            if mask is not None:
                of_camera[f"{part} error"] += float(error[mask].mean(axis=1).sum())
                of_camera[f"{part} pixels"] += int(mask.sum())
        if progress:
            progress(done + 1, len(chosen))
    return {
        **_figures(list(sums.values()), more),
        "split": split,
        **training_of(scene),
        "cameras": {name: _figures([part], more) for name, part in sums.items()},
    }


def training_of(scene: ScenePlayer) -> Figures:
    """What every evaluation says of a scene besides its metrics."""
    return {"method": scene.header.method, "gaussians": scene.count, "steps": scene.header.steps}


def _both(mask: Mask | None, counted: Mask | None) -> Mask | None:
    return mask if mask is None or counted is None else mask & counted


_Sums = defaultdict[str, float]
"""Over the images of one camera, by name."""


def _figures(parts: Sequence[_Sums], more: Iterable[str]) -> Figures:
    """Metrics over the images of some cameras."""

    def total(name: str) -> float:
        return sum(part[name] for part in parts)

    def psnr_in(name: str) -> float | None:
        return psnr_of(total(f"{name} error") / total(f"{name} pixels")) if total(f"{name} pixels") else None

    frames, true_sharpness, inside = total("frames"), total("true sharpness"), psnr_in("inside")
    return {
        "psnr": total("psnr") / frames,
        "psnr_moving": psnr_in("moving"),
        **({} if inside is None else {"psnr_inside": inside}),
        "ssim": total("ssim") / frames,
        **{name: total(name) / frames for name in more},
        "sharpness_moving": total("sharpness") / true_sharpness if true_sharpness else None,
        "frames": frames,
    }


def metrics_named(names: Iterable[str]) -> dict[str, Metric]:
    """Further metrics, of ``registry.METRICS``.

    Raises:
        FrogError: for a name that there is not, or that a figure of ours has.
    """
    metrics = {name: METRICS[name] for name in names if name not in ALWAYS}
    for name in metrics:
        if name in _FIGURES:
            raise UsageError(
                f"The metric {name!r} has the name of a figure of every evaluation, expected another name."
            )
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


def images_of(split: str, scene: ScenePlayer, capture: Capture) -> tuple[list[int], str]:
    """Indices into ``capture.shots`` of a split, and its name; FrogError where it has no image, or another name."""
    held_out = held_out_shots(scene, capture)
    known = {"auto": "held-out" if held_out else "training", **SPLITS}
    if split not in known:
        raise UsageError(f"found the split {brief(split)}, expected one of {', '.join(known)}.")
    split = known[split]
    chosen = held_out if split == "held-out" else sorted(set(range(len(capture.shots))) - set(held_out))
    if not chosen:
        raise FrogError(f"{capture.path}: there is no {split} image to evaluate on.")
    return chosen, split


def evaluate_file(
    scene_path: Path,
    capture_path: Path,
    *,
    split: str = "auto",
    mask_file: Path | None = None,
    more_metrics: Mapping[str, Metric] | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> Figures:
    """Metrics of a scene file on the capture it was trained on, and its "bytes"; see ``evaluate_images``.

    Args:
        mask_file: see ``TrueImages``.

    Raises:
        FrogError: if a file cannot be read or does not fit, or the capture is another one than that of the training.
    """
    scene = ScenePlayer.load(scene_path)
    capture = open_training_capture(scene, capture_path)
    images_of(split, scene, capture)  # what there is not is refused before minutes of decoding
    images = TrueImages(capture, None, mask_file)
    figures = evaluate_images(scene, images, split=split, more_metrics=more_metrics, progress=progress)
    return {**figures, "bytes": scene_path.stat().st_size}


def open_training_capture(scene: ScenePlayer, capture_path: Path) -> Capture:
    """The capture as the training of a scene saw it: the same image size, pixel offsets and refined poses.

    Raises:
        FrogError: if it cannot be read, or has other cameras or frames than the scene.
    """
    return as_trained(scene.header, open_as_read(scene.header, capture_path))


def open_as_read(header: SceneHeader, capture_path: Path) -> Capture:
    """The capture at its own size, read by what the training of a scene was told of it; FrogError if it cannot be."""
    return open_capture(
        capture_path, pixel_offsets=header.pixel_offsets or None, masks=header.masks, layout=header.layout
    )
