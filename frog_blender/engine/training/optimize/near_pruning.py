"""Gaussians right before cameras are removed: each explains what one camera's images have of their own, and hangs
before the others."""

import numpy as np
import torch

from ...arrays import Float32s
from ...capture.camera import evenly_chosen
from ...capture.capture import Capture
from .gaussian_state import GaussianState, distances, look_through

_BESIDE = 0.5  # of an image's sides: what hangs there is before a camera that stands beside this one
_DOUBTED = 1e-3  # share of the seed points before a camera that may be mistaken
_FEWEST = 100  # seed points that tell how near a camera things are


class NearPruning:
    """Keeps the space before the training cameras empty where no seed point is.

    Args:
        capture: whose training cameras are looked through.
        points: (N, 3) seed points, world units.
        share: of the distance to the nearest seed points before a camera, nearer than which nothing may be.
    """

    def __init__(self, capture: Capture, points: Float32s, share: float) -> None:
        self._limits: dict[int, float] = {}  # world units, by camera
        for index in evenly_chosen(capture.train_cameras):
            camera = capture.cameras[index]
            before = points[look_through(camera, torch.tensor(points, device="cpu"), _BESIDE)[1].numpy()]
            if len(before) >= _FEWEST:
                away = np.linalg.norm(before - camera.center, axis=1)
                self._limits[index] = share * float(np.quantile(away, _DOUBTED))

    def prune(self, gaussians: GaussianState, capture: Capture) -> None:
        """Removes what is too near to one of ``capture``'s cameras, wherever that has moved."""
        means = gaussians.canonical.means.detach()
        near = torch.zeros(len(means), dtype=torch.bool, device=means.device)
        for index, limit in self._limits.items():
            camera = capture.cameras[index]
            some = (distances(means, camera) < limit).nonzero().squeeze(1)
            near[some] |= look_through(camera, means[some], _BESIDE)[1]
        if near.any() and not near.all():
            gaussians.keep((~near).nonzero().squeeze(1))
