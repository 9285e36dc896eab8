"""The region that a scene's cameras see together, as a box: where a first crop goes."""

from __future__ import annotations

import numpy as np

from ..arrays import Array
from ..playback.player import ScenePlayer

SEEN = 0.05
"""Blending weight from which an image shows a Gaussian; training removes what stays below it everywhere."""
_MOST = 0.01, 0.99  # quantiles of their places; single ones lie kilometres away


def seen_by(weights: Array) -> Array:
    """(N,) how many cameras see each Gaussian, of weights (C, N)."""
    result: Array = np.count_nonzero(weights > SEEN, axis=0)
    return result


def common_view(scene: ScenePlayer, weights: Array) -> Array:
    """(2, 3) the corners of a box around nearly all Gaussians that half of the cameras see; of all, without cameras.

    Args:
        weights: (C, N) see ``importance.camera_weights``.
    """
    means = scene.at(0.5).means
    shared = seen_by(weights) >= max(1, len(weights) / 2)
    points = means[shared] if shared.any() else means
    corners: Array = np.quantile(points.astype(np.float64), _MOST, axis=0)
    return corners
