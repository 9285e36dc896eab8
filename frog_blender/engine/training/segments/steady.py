"""Which of the whole take's static Gaussians its segments share: those that fit its images at all times.

A training that has few moments of a long take finds some Gaussians static that are only still for most of it, or that
are a blur of what it cannot follow. Where they are seen, images are not what the scene shows.
"""

from __future__ import annotations

from .. import passive_threads  # noqa: F401

# isort: split
from pathlib import Path

import cv2
import numpy as np
import torch
from safetensors.numpy import save as serialize

from ...arrays import Array, Ints
from ...capture.capture import Capture
from ...capture.seeding.views import spread
from ...errors import found_instead
from ...frames.store import FrameStore
from ...gaussians import GaussianArrays
from ...io.atomic_files import write_atomically
from ...io.tensor_files import read_tensors
from ...playback.player import ScenePlayer
from ...playback.render import render_image
from ...scene.scene_file import SceneFile
from ..compression.static_regions import sums_of_pixels

_VIEWS = 64
_PATCH = 3  # pixels
_LARGEST_ERROR = 0.08  # of the display range, of a root mean square over what is seen of a Gaussian
_KIND = "rows of shared Gaussians"


def steady_rows(scene: SceneFile, capture: Capture, store: FrameStore) -> Ints:
    """(F,) ascending, which of a scene's Gaussians are static and fit the training images wherever they are seen.

    Args:
        capture: what it was trained on; images with masks are not looked at.
    """
    player, sums = ScenePlayer(scene), torch.zeros((), device="cpu")
    rows = np.arange(player.num_dynamic, player.count)
    if capture.has_masks or not len(rows):
        return rows
    for index in spread(capture.train_indices, _VIEWS):
        shot = capture.shots[index]
        camera, gaussians = capture.cameras[shot.camera], player.at(capture.time_of(shot))
        drawn = render_image(gaussians, camera, capture.background)
        error = np.square(drawn.astype(np.float32) / 255 - store.image(index).astype(np.float32) / 255).mean(axis=2)
        tensors = GaussianArrays(*(torch.from_numpy(np.array(array)) for array in vars(gaussians).values()))
        smooth = np.asarray(cv2.blur(error, (_PATCH, _PATCH)), np.float32)
        sums = sums + sums_of_pixels(tensors, camera, smooth, capture.background)
    total, weight = sums[rows, 0].numpy(), sums[rows, 1].numpy()
    fits: Array = (weight < 1) | (total <= _LARGEST_ERROR**2 * weight)
    return rows[fits]


def write_rows(path: Path, rows: Ints) -> None:
    """Atomically; FrogError when it cannot."""
    write_atomically(path, serialize({"rows": rows.astype(np.int64)}))


def read_rows(path: Path, count: int) -> Ints:
    """What ``write_rows`` wrote, of a scene of ``count`` Gaussians; FrogError for anything else."""
    rows = read_tensors(path, _KIND, lambda name: name == "rows")[0].get("rows")
    fits = rows is not None and rows.dtype == np.int64 and rows.ndim == 1 and bool((np.diff(rows) > 0).all())
    if rows is None or not fits or (len(rows) and not 0 <= rows[0] <= rows[-1] < count):
        raise found_instead(path, "other numbers", _KIND)
    return np.asarray(rows, np.int64)
