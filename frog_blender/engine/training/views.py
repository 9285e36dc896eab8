"""How a capture was filmed decides what can be learned of it: the recipe as a training of this capture follows it."""

from __future__ import annotations

from dataclasses import replace

from ..capture.capture import Capture
from .recipe import Recipe


def views_per_moment(capture: Capture) -> float:
    """Training images of a moment, in the mean over the moments that have any; 0 where there are none."""
    shots = capture.train_shots
    return len(shots) / len({shot.frame for shot in shots}) if shots else 0.0


def fit_to(recipe: Recipe, capture: Capture) -> Recipe:
    """The recipe for this capture.

    Where each moment is seen from one place, and the next from another, a colour that changes with time explains any
    image that the geometry does not, and is wrong from everywhere else. There Gaussians move, turn and grow, as in
    Deformable-3DGS, and keep their colours and opacities. A camera that stands still sees what changes.
    """
    if not capture.has_moving_cameras or views_per_moment(capture) >= recipe.appearance_views:
        return recipe
    return replace(recipe, deformed_sh=0, deformed_opacity=False)
