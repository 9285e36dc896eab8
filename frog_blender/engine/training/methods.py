"""The methods that the trainer knows: FRoG and its baselines, each with the recipe as it trains it.

All share canonical Gaussians, rasterizer, losses and schedules, so that a comparison compares methods.
"""

from __future__ import annotations

from . import passive_threads  # noqa: F401

# isort: split
from collections.abc import Callable
from dataclasses import dataclass, replace

from ..errors import FrogError
from ..model.baselines import curves, d3dgs, hexplane
from ..model.baselines.static import Static
from ..model.canonical import CanonicalField
from ..model.frog import Frog, FrogSettings
from ..model.interface import SceneModel
from ..recipes import Recipe

MOTION_UNIT = 0.2
"""What a network's output of one moves a Gaussian by, times the scene's scale: the same for every method."""


@dataclass(frozen=True)
class ModelInit:
    """What a model is made of.

    Attributes:
        canonical: the seeds' Gaussians, with embeddings (N, E) of zeros, of ``recipe.embedding_size`` and what is kept
            for time windows (see model.time_windows).
        recipe: as the method adapted it.
        frame_count: frames of the capture.
        image_count: training images.
        scene_scale: world units, see ``initialization.scale_of``.
    """

    canonical: CanonicalField
    recipe: Recipe
    frame_count: int
    image_count: int
    scene_scale: float


@dataclass(frozen=True)
class Method:
    """A way to model motion.

    Attributes:
        title: as people write it.
        adapt: the recipe as this method trains it.
        build: its model before the first step.
    """

    title: str
    adapt: Callable[[Recipe], Recipe]
    build: Callable[[ModelInit], SceneModel]


def _frog(begin: ModelInit) -> Frog:
    recipe, sh_count = begin.recipe, begin.canonical.sh.shape[1]
    rows = recipe.temporal_rows_for(begin.frame_count, begin.image_count)
    settings = FrogSettings(
        temporal_rows=rows,
        coarse_rows=recipe.coarse_rows_for(rows),
        temporal_size=recipe.temporal_size,
        embedding_size=begin.canonical.embeddings.shape[1],
        hidden_width=recipe.hidden_width,
        head_width=recipe.head_width,
        deformed_sh=min(recipe.deformed_sh, sh_count),
        opacity_reduction=recipe.opacity_reduction,
        opacity_sharpness=recipe.opacity_sharpness,
        motion_unit=MOTION_UNIT * begin.scene_scale,
        fusion=recipe.fusion,
        deformed_opacity=recipe.deformed_opacity,
        modulation=recipe.modulation,
    )
    return Frog(begin.canonical, settings, recipe.table_smoothness)


def _embedded(recipe: Recipe) -> Recipe:
    """As it is; FrogError without embeddings, which tell FRoG's network one Gaussian from another."""
    if not recipe.embedding_size:
        raise FrogError("embedding_size is 0, expected at least 1 for this method.")
    return recipe


def _ed3dgs(recipe: Recipe) -> Recipe:
    """FRoG's base: dual networks, nothing that is FRoG's or ours."""
    return replace(
        _embedded(recipe),
        fusion="dual",
        modulation=False,
        moment_seeds=False,
        appearance_views=0.0,
        size_limit=0.0,
        sampling="off",
        opacity_reduction="off",
        capacity="fixed",
    )


def _plain(recipe: Recipe, embedding_size: int = 0) -> Recipe:
    """Nothing of FRoG's own."""
    return replace(
        recipe,
        embedding_size=embedding_size,
        moment_seeds=False,
        appearance_views=0.0,
        size_limit=0.0,
        sampling="off",
        opacity_reduction="off",
        smoothness_weight=0.0,
        capacity="fixed",
    )


def _d3dgs_recipe(recipe: Recipe) -> Recipe:
    """Its deep network learns best at three times the rate of FRoG's one layer (docs/experiments/baselines.md)."""
    return replace(_plain(recipe), network_rate=3 * recipe.network_rate)


def _curves_recipe(recipe: Recipe) -> Recipe:
    """The units of its coefficients make the embeddings' rate right for them (see CurveSettings)."""
    return _plain(recipe, curves.EMBEDDING_SIZE)


def _d3dgs(begin: ModelInit) -> d3dgs.D3dgs:
    scale = begin.scene_scale
    settings = d3dgs.settings_for(begin.recipe.hidden_width, begin.frame_count, MOTION_UNIT * scale)
    return d3dgs.D3dgs(begin.canonical, settings, scale)


def _hexplane(begin: ModelInit) -> hexplane.HexPlane:
    recipe, sh_count = begin.recipe, begin.canonical.sh.shape[1]
    settings = hexplane.settings_for(
        recipe.hidden_width,
        recipe.head_width,
        begin.frame_count,
        min(recipe.deformed_sh, sh_count),
        recipe.deformed_opacity,
        MOTION_UNIT * begin.scene_scale,
    )
    return hexplane.HexPlane(begin.canonical, settings)


def _curves(begin: ModelInit) -> curves.Curves:
    return curves.Curves(begin.canonical, curves.settings_for(MOTION_UNIT * begin.scene_scale))


METHODS = {
    "frog": Method("FRoG", _embedded, _frog),
    "ed3dgs": Method("E-D3DGS", _ed3dgs, _frog),
    "static": Method("3DGS (static)", _plain, lambda begin: Static(begin.canonical)),
    "d3dgs": Method("Deformable-3DGS", _d3dgs_recipe, _d3dgs),
    "hexplane": Method("4DGaussians", _plain, _hexplane),
    "curves": Method("SpacetimeGaussians", _curves_recipe, _curves),
}


def method_named(name: str) -> Method:
    """FrogError for a name that does not exist."""
    if name not in METHODS:
        raise FrogError(f"There is no method {name!r}; there are {', '.join(METHODS)}.")
    return METHODS[name]
