"""No Gaussian reaches the cameras: one that wraps them tints all their images, and is fog from everywhere else.

A surface ends well before a camera that sees it. A few Gaussians larger than the scene are the quickest way to the
right brightness, and stay for ever: seen from outside, four of them covered all of the room's surroundings.
"""

from __future__ import annotations

import numpy as np
import torch
from numpy.typing import NDArray

from ...capture.capture import Capture
from ...rasterizer.reference import rotation_matrices
from ..recipe import Recipe
from .hooks import Hook, Training
from .schedule import Every

_EVERY = 0.01  # of the training
_MOST_CAMERAS = 32  # of a camera's path, or of more cameras: evenly spread ones
_LEAST = 1e-3  # a Gaussian at a camera shrinks by that at a time, not to nothing


class CameraClearance(Hook):
    """Shrinks Gaussians that have a training camera within ``clearance`` standard deviations of their centre, until it
    is that far. A wall may be as wide as it likes, but not as thick.

    Args:
        capture: whose training cameras count.
        clearance: see ``Recipe``.
    """

    def __init__(self, capture: Capture, clearance: float) -> None:
        self._centers, self._clearance = camera_centers(capture), clearance
        self._due = Every(0.0, 1.0, _EVERY)

    def after_step(self, training: Training, before: float, now: float) -> None:
        """Shrinks what is too large, where that is due in (before, now]."""
        if self._due.due(before, now):
            self.shrink(training)

    @torch.no_grad()
    def shrink(self, training: Training) -> None:
        """Shrinks what is too large."""
        canonical = training.gaussians.canonical
        centers = torch.from_numpy(self._centers).to(canonical.means)
        # By differences: the expansion of the square, which is quicker for many, cancels far from the origin.
        distances = torch.cdist(canonical.means, centers, compute_mode="donot_use_mm_for_euclid_dist").amin(1)
        large = self._clearance * canonical.log_scales.amax(1).exp() > distances
        chosen = large.nonzero().squeeze(1)  # no others can be too near
        if not len(chosen):
            return
        means, log_scales = canonical.means[chosen], canonical.log_scales[chosen]
        found = standard_deviations(means, canonical.quaternions[chosen], log_scales, centers)
        factors = (found / self._clearance).clamp(_LEAST, 1)
        canonical.log_scales.data[chosen] += factors.log()[:, None]


def camera_centers(capture: Capture) -> NDArray[np.float32]:
    """(C, 3) centres of the training cameras, evenly spread ones of many."""
    cameras = sorted({shot.camera for shot in capture.train_shots})
    chosen = np.unique(np.linspace(0, len(cameras) - 1, min(len(cameras), _MOST_CAMERAS)).round().astype(int))
    return np.array([capture.cameras[cameras[index]].center for index in chosen], np.float32)


def standard_deviations(
    means: torch.Tensor, quaternions: torch.Tensor, log_scales: torch.Tensor, centers: torch.Tensor
) -> torch.Tensor:
    """(N,) from each Gaussian's mean to the nearest of the centres (C, 3), in standard deviations that way."""
    rotations = rotation_matrices(quaternions)
    own = torch.einsum("nji,ncj->nci", rotations, centers - means[:, None])
    found: torch.Tensor = (own / log_scales.exp()[:, None]).norm(dim=2).amin(1)
    return found


def clearance_hooks(recipe: Recipe, capture: Capture) -> list[Hook]:
    """What a trainer needs to keep Gaussians clear of cameras; nothing where the recipe does not ask for it."""
    return [CameraClearance(capture, recipe.camera_clearance)] if recipe.camera_clearance else []
