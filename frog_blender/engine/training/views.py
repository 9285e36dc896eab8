"""How a capture was filmed decides what can be learned of it: the recipe as a training of this capture follows it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ..capture.capture import Capture
from ..recipes import Recipe

_LEAP = 15.0
"""Degrees between the cameras of an image and the next, in the median, from which on neighbouring moments show
different sides of things. A film turns by one or two; D-NeRF's cameras by a hundred."""


def views_per_moment(capture: Capture) -> float:
    """Training images of a moment, in the mean over the moments that have any; 0 where there are none."""
    shots = capture.train_shots
    return len(shots) / len({shot.frame for shot in shots}) if shots else 0.0


def turn_between_images(capture: Capture) -> float:
    """Median angle in degrees between the orientations of one training image's camera and the next one's in time."""
    rotations = np.array([capture.cameras[shot.camera].rotation for shot in capture.train_shots])
    if len(rotations) < 2:
        return 0.0
    cosines = (np.einsum("nij,nij->n", rotations[:-1], rotations[1:]) - 1) / 2
    return float(np.degrees(np.median(np.arccos(cosines.clip(-1, 1)))))


def fit_to(recipe: Recipe, capture: Capture) -> Recipe:
    """The recipe for this capture.

    Where each moment is seen from one place, and the next from quite another, a colour that changes with time explains
    any image that the geometry does not, and is wrong from everywhere else. There Gaussians move, turn and grow, as in
    Deformable-3DGS, and keep their colours and opacities; and they are kept small, since nothing else says how deep
    they are. The many sides say more, too, of how a surface shines and of its silhouette. The loss has no squares: what
    no other image sees alike costs the most by them, and is learned by heart. A camera that stands still, or moves on
    slowly, sees what changes.
    """
    few_views = capture.has_moving_cameras and views_per_moment(capture) < recipe.appearance_views
    if few_views and turn_between_images(capture) >= _LEAP:
        return replace(
            recipe,
            deformed_sh=0,
            deformed_opacity=False,
            sh_degree=max(recipe.sh_degree, min(recipe.sides_sh_degree, len(recipe.sh_growth))),
            alpha_weight=max(recipe.alpha_weight, recipe.sides_alpha_weight),
            square_weight=0.0,
        )
    return replace(recipe, size_weight=0.0)
