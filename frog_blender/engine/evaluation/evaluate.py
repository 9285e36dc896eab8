"""How good a finished scene is, on images of the capture it was trained on. No torch."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from ..capture.capture import Capture
from ..capture.frames import FrameStore
from ..capture.image_size import image_size
from ..capture.video import read_gray
from ..errors import FrogError, found_instead
from ..io.numpy_files import read_npz
from ..io.regular_file import regular_file
from ..playback.player import ScenePlayer
from ..playback.render import draw
from .metrics import gradient_energy, psnr_of, ssim

Measure = Callable[[np.ndarray, np.ndarray], float]
"""A figure of an image and its truth, both (H, W, 3) in [0, 1]."""

_MASKS = "an image or an .npz of masks"
_MORE_FRAMES = 1000  # masks may be of the whole film, where a capture ends before
_MOVING_DEVIATION = 6 / 255  # temporal standard deviation above which a pixel counts as moving


@dataclass
class _Sums:
    """Running sums over one camera's images."""

    psnr: float = 0.0
    ssim: float = 0.0
    frames: int = 0
    masked_error: float = 0.0
    masked_count: int = 0
    sharpness: float = 0.0
    true_sharpness: float = 0.0
    measured: dict[str, float] = field(default_factory=dict)


def moving_mask(store: FrameStore, shot_indices: list[int]) -> np.ndarray:
    """(H, W) bool: pixels of one fixed camera whose standard deviation over time, in the channel where it is largest,
    exceeds 6/255 in the true images."""
    total = square = np.zeros(())
    for index in shot_indices:
        image = store.image(index).astype(np.float64) / 255
        total = total + image
        square = square + image**2
    count = len(shot_indices)
    variance = square / count - (total / count) ** 2
    return np.sqrt(np.maximum(variance, 0).max(axis=2)) > _MOVING_DEVIATION


def load_masks(path: Path, capture: Capture) -> dict[str, np.ndarray]:
    """Masks by camera name: an image (white counts) for all cameras, or an ``.npz`` with an array for each camera,
    (H, W) or (frames, H, W). FrogError when a name or a size does not fit."""
    regular_file(path, _MASKS)
    names = {camera.name: (camera.height, camera.width) for camera in capture.cameras}

    def check(name: str, shape: tuple[int, ...]) -> None:
        if name not in names:
            shown = ", ".join([*list(names)[:12], "..."] if len(names) > 12 else names)
            raise found_instead(path, f"a mask named {name!r}", f"names of cameras: {shown}")
        height, width = names[name]
        if shape[-2:] != names[name] or len(shape) not in (2, 3) or not shape[0]:
            raise found_instead(path, f"a mask of {shape}", f"{height} x {width} for {name}")

    if path.suffix.lower() == ".npz":
        pixels = sum(height * width for height, width in names.values())
        masks = read_npz(path, _MASKS, check, (capture.frame_count + _MORE_FRAMES) * pixels)
        return {name: mask > 0 for name, mask in masks.items()}
    size = image_size(path)
    for name in names:
        check(name, size[::-1])
    return dict.fromkeys(names, read_gray(path) > 127)


def evaluate(
    scene: ScenePlayer,
    capture: Capture,
    store: FrameStore,
    *,
    split: str = "auto",
    mask_file: Path | None = None,
    file_bytes: int = 0,
    measures: Mapping[str, Measure] | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> dict[str, Any]:
    """Figures as plain values, over all cameras and for each.

    ``psnr`` and ``ssim`` are means over images; ``psnr_moving`` comes from the mean squared error over the masked
    pixels of all images. Without a mask file the mask is ``moving_mask``, which a moving camera does not have.

    Args:
        split: "held-out", "training", or "auto": held-out images if there are any.
        measures: further figures by name, means over images (see comparison.perceptual); they take time.
    """
    header = scene.header
    held_out = [
        i for i, shot in enumerate(capture.shots) if header.is_test(capture.cameras[shot.camera].name, shot.frame)
    ]
    if split == "auto":
        split = "held-out" if held_out else "training"
    chosen = held_out if split == "held-out" else sorted(set(range(len(capture.shots))) - set(held_out))
    if not chosen:
        raise FrogError(f"{capture.path}: there is no {split} image to evaluate on.")
    masks = load_masks(mask_file, capture) if mask_file else None
    mask_cache: dict[int, np.ndarray | None] = {}

    def mask_of(camera: int, frame: int) -> np.ndarray | None:
        if masks is not None:
            mask = masks.get(capture.cameras[camera].name)
            return mask if mask is None or mask.ndim == 2 else mask[min(frame, len(mask) - 1)]
        if camera not in mask_cache:
            shots = [i for i, shot in enumerate(capture.shots) if shot.camera == camera]
            mask_cache[camera] = moving_mask(store, shots) if len(shots) > 1 else None
        return mask_cache[camera]

    sums: dict[str, _Sums] = {}
    for done, index in enumerate(chosen):
        shot = capture.shots[index]
        camera = capture.cameras[shot.camera]
        truth = store.image(index).astype(np.float32) / 255
        image = draw(scene.at_frame(shot.frame), camera, header.background).rgb.clip(0, 1)
        error = (image.astype(np.float64) - truth) ** 2
        entry = sums.setdefault(camera.name, _Sums())
        entry.psnr += psnr_of(float(error.mean()))
        entry.ssim += ssim(image, truth)
        for name, measure in (measures or {}).items():
            entry.measured[name] = entry.measured.get(name, 0.0) + measure(image, truth)
        entry.frames += 1
        mask = mask_of(shot.camera, shot.frame)
        if mask is not None and mask.any():
            entry.masked_error += float(error[mask].mean(axis=1).sum())
            entry.masked_count += int(mask.sum())
            entry.sharpness += gradient_energy(image, mask)
            entry.true_sharpness += gradient_energy(truth, mask)
        if progress:
            progress(done + 1, len(chosen))
    return _report(scene, sums, split, file_bytes)


def _report(scene: ScenePlayer, sums: dict[str, _Sums], split: str, file_bytes: int) -> dict[str, Any]:
    def figures(parts: list[_Sums]) -> dict[str, Any]:
        frames, count = sum(p.frames for p in parts), sum(p.masked_count for p in parts)
        true_sharpness = sum(p.true_sharpness for p in parts)
        return {
            "psnr": sum(p.psnr for p in parts) / frames,
            "psnr_moving": psnr_of(sum(p.masked_error for p in parts) / count) if count else None,
            "ssim": sum(p.ssim for p in parts) / frames,
            **{name: sum(p.measured[name] for p in parts) / frames for name in parts[0].measured},
            "sharpness_moving": sum(p.sharpness for p in parts) / true_sharpness if true_sharpness else None,
            "frames": frames,
        }

    return {
        **figures(list(sums.values())),
        "split": split,
        "method": scene.header.method,
        "gaussians": scene.count,
        "bytes": file_bytes,
        "steps": scene.header.steps,
        "train_seconds": scene.header.train_seconds,
        "cameras": {name: figures([part]) for name, part in sums.items()},
    }
