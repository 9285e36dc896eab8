"""How a training builds the model of each method that ``registry`` names, and the recipe as the method and the capture
adapt it: how a capture was filmed decides what can be learned of it.

All share canonical Gaussians, rasterizer, losses, schedules and limits, so that a comparison compares methods.
"""

from . import passive_threads  # noqa: F401

# isort: split
from dataclasses import dataclass, fields, replace

import numpy as np
import torch

from ..capture.capture import Capture
from ..errors import FrogError
from ..field.names import WINDOW_COLUMNS
from ..model.canonical import CanonicalField
from ..model.deformation import FrogSettings
from ..model.frog import Frog
from ..model.interface import Static
from ..recipes import Recipe

MOTION_UNIT = 0.2
"""What a network's output of one moves a Gaussian by, times the scene's scale: the same for every method."""


@dataclass(frozen=True)
class ModelInit:
    """What a model is made of.

    Attributes:
        canonical: the seeds' Gaussians, with embeddings (N, E) of zeros, of ``recipe.embedding_size``.
        recipe: as the method adapted it.
        frame_count: frames of the capture.
        image_count: training images.
        scene_scale: world units, see ``initialization.scale_of``.
        times: (N,) in [0, 1] at which each of the seeds' Gaussians is there, NaN for all times; None where all are.
    """

    canonical: CanonicalField
    recipe: Recipe
    frame_count: int
    image_count: int
    scene_scale: float
    times: torch.Tensor | None = None


def frog(begin: ModelInit) -> Frog:
    """FRoG, or E-D3DGS by another recipe."""
    recipe, canonical = begin.recipe, begin.canonical
    if begin.times is not None:  # columns of their own, see model.time_windows
        canonical.embeddings = torch.nn.Parameter(torch.nn.functional.pad(canonical.embeddings, (0, WINDOW_COLUMNS)))
    rows = recipe.temporal_rows_for(begin.frame_count, begin.image_count)
    named = {field.name: getattr(recipe, field.name) for field in fields(FrogSettings) if hasattr(recipe, field.name)}
    adapted = {
        "temporal_rows": rows,
        "coarse_rows": recipe.coarse_rows_for(rows),
        "embedding_size": canonical.embeddings.shape[1],
        "deformed_sh": min(recipe.deformed_sh, canonical.sh.shape[1]),
        "motion_unit": MOTION_UNIT * begin.scene_scale,
    }
    settings = FrogSettings(**{**named, **adapted})
    return Frog(canonical, settings, recipe.table_smoothness)


def embedded(recipe: Recipe) -> Recipe:
    """As it is; FrogError without embeddings, which tell FRoG's network one Gaussian from another."""
    if not recipe.embedding_size:
        raise FrogError("embedding_size is 0, expected at least 1 for this method.")
    return recipe


def ed3dgs(recipe: Recipe) -> Recipe:
    """FRoG's base: dual networks, nothing that is FRoG's or ours."""
    bare = plain(embedded(recipe), recipe.embedding_size)
    return replace(bare, fusion="dual", modulation=False, smoothness_weight=recipe.smoothness_weight)


def plain(recipe: Recipe, embedding_size: int = 0) -> Recipe:
    """Nothing of FRoG's own."""
    return replace(
        recipe,
        embedding_size=embedding_size,
        moment_seeds=False,
        sampling="off",
        opacity_reduction="off",
        smoothness_weight=0.0,
        capacity="fixed",
    )


def static(begin: ModelInit) -> Static:
    """What does not move."""
    return Static(begin.canonical)


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
    they are, and near ones move alike, since nothing else says what stands still. The many sides say more, too, of how
    a surface shines and of its silhouette. The loss has no squares: what no other image sees alike costs the most by
    them, and is learned by heart. A camera that stands still, or moves on slowly, sees what changes.
    """
    few_views = capture.has_moving_cameras and views_per_moment(capture) < recipe.appearance_views
    if few_views and turn_between_images(capture) >= _LEAP:
        return replace(
            recipe,
            deformed_sh=0,
            deformed_opacity=False,
            sh_degree=max(recipe.sh_degree, min(recipe.sides_sh_degree, len(recipe.sh_growth))),
            alpha_weight=max(recipe.alpha_weight, recipe.sides_alpha_weight),
            smoothness_weight=recipe.smoothness_weight and max(recipe.smoothness_weight, recipe.sides_smoothness),
            square_weight=0.0,
        )
    return replace(recipe, size_weight=0.0)
