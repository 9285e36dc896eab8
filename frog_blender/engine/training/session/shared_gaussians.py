"""Static Gaussians that several trainings share: each draws with them, none changes them, and none seeds them again."""

from __future__ import annotations

from .. import passive_threads  # noqa: F401

# isort: split
from dataclasses import replace

import numpy as np
import torch

from ...arrays import Array, Float64s, SceneArrays
from ...capture.capture import Capture
from ...capture.seeding.views import spread
from ...capture.seeds import Seeds
from ...frames.store import FrameStore
from ...playback.canonical import canonical_gaussians
from ...playback.render import render_image
from ..optimize.fixed_gaussians import SHARED_ATTRIBUTES
from ..optimize.hooks import Hook, Training

_FRAMES = 3  # at which images are compared, besides the middle one
_PATCH = 5  # pixels: single wrong pixels are noise
_EXPLAINED = 0.05  # of the display range, below which a pixel is what the shared Gaussians show
_LEAST = 300  # seed points, whatever is explained: the worst explained ones


class SharedGaussians(Hook):
    """Adds Gaussians that stay as they are to a training before its first step.

    Args:
        arrays: canonical arrays (F, ...), as a scene file has them.
    """

    def __init__(self, arrays: SceneArrays) -> None:
        self._arrays = arrays

    def begin(self, training: Training) -> None:
        """See Hook."""
        device = training.gaussians.device
        values = {name: torch.from_numpy(np.array(self._arrays[name])).to(device) for name in SHARED_ATTRIBUTES}
        training.gaussians.add_fixed(values)


def unexplained(seeds: Seeds, capture: Capture, store: FrameStore, shared: SceneArrays) -> Seeds:
    """The seed points at which images are not what the shared Gaussians show; all of them where images have masks.

    What is hidden in one image may be seen in others, so the middle one of a frame's images decides. Points on what
    moves need to be seen at one of a few frames only.
    """
    if capture.has_masks:
        return seeds
    wrong = _worst_differences(seeds.points.astype(np.float64), capture, store, shared)
    if seeds.frames is not None:
        wrong[np.isfinite(seeds.frames)] = np.inf  # seen at moments of their own
    least = np.sort(wrong)[-min(_LEAST, len(wrong))]
    kept = wrong >= min(_EXPLAINED, least)
    frames = None if seeds.frames is None else seeds.frames[kept]
    origin = f"{seeds.origin}; {int(kept.sum())} beside {len(shared['means'])} shared"
    return replace(seeds, points=seeds.points[kept], colors=seeds.colors[kept], frames=frames, origin=origin)


def _worst_differences(points: Float64s, capture: Capture, store: FrameStore, shared: SceneArrays) -> Array:
    """(N,) at each point the difference that the middle image of a frame has, of the frame where that is most."""
    gaussians, train = canonical_gaussians(shared).checked(), capture.train_indices
    frames = sorted({capture.shots[index].frame for index in train})
    worst = np.zeros(len(points))
    for frame in {*spread(frames, _FRAMES), frames[len(frames) // 2]}:
        of_views = []
        for index in (index for index in train if capture.shots[index].frame == frame):
            camera = capture.cameras[capture.shots[index].camera]
            drawn = render_image(gaussians, camera, capture.background)
            difference = _smoothed(np.abs(drawn.astype(np.float32) - store.image(index)).mean(axis=2) / 255)
            pixels, depth = camera.project(points)
            column, row = np.floor(np.nan_to_num(pixels, nan=-1.0)).clip(-1, 2**30).astype(np.int64).T
            inside = (depth > 0) & (column >= 0) & (column < camera.width) & (row >= 0) & (row < camera.height)
            found = np.full(len(points), np.nan)
            found[inside] = difference[row[inside], column[inside]]
            of_views.append(found)
        seen = np.isfinite(of_views).any(axis=0)
        worst[seen] = np.maximum(worst[seen], np.nanmedian(np.array(of_views)[:, seen], axis=0))
    return worst


def _smoothed(image: Array) -> Array:
    import cv2

    return np.asarray(cv2.blur(image, (_PATCH, _PATCH)))
