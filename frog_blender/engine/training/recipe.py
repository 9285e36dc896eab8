"""Every setting of a training. Schedules are fractions of the training, so that a draft passes through all of it."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

from ..errors import FrogError, brief
from ..field.names import FORMS, FUSIONS, WINDOW_COLUMNS, network_count
from . import setting
from .setting import check_all, choice, flag, fractions, kinds_of, number, whole

SAMPLINGS = ("anchors", "inverse", "off")
_MOST_COARSE_ROWS = 30
# Far beyond what trains well, but what any computer of today can hold: a recipe may come from a file.
_MOST_STEPS, _MOST_GAUSSIANS, _MOST_SEEDS, _WIDEST, _FASTEST = 10**9, 10**7, 10**6, 1024, 10.0
_NEVER, _OFTENEST = 10.0, 1e-6  # fractions of a training
_MOST_NUMBERS = 2**27  # of all seed points' attributes together
_GROWN, _GROWN_FROM = 1.075, 0.5
"""Times as many Gaussians as a scene keeps, with automatic capacity, before what images do not miss is pruned; and the
fraction of the training before which there are no more than it keeps."""


@dataclass(frozen=True)
class Recipe:
    """How to train. Lengths are in world units times the scene's scale (median distance from camera to seed point).

    Attributes:
        name: "draft" or "standard"; "paper" (N3DV), "hypernerf" and "technicolor" follow the papers.
        steps: optimiser steps, each on ``views_per_step`` images or parts of them, at least.
        steps_per_moment: for each of the capture's frames; what is longer of the two is trained.
        views_per_step: images whose gradients a step takes the mean of; with several processes one for each at least.
        max_gaussians: of a scene at most, see ``growth_limit_at``.
        kept_gaussians: of them, those that a scene has in the end at most, with automatic capacity; 0 for as many as it
            needs (see compression.budget).
        seed_gaussians: seed points at most.
        seed_share: of the seed points, those that may be measured, see ``find_seeds``; for tests of stability.
        moment_seeds: whether what moves before eight static cameras or more has seed points at many times, each seen
            at its own to begin with (see model.time_windows): for what flies past and would be missing otherwise.
        sh_degree: 0 to 3; grows by one at each of ``sh_growth`` (fractions of training, one for each degree at least).
        capacity: "auto" leaves a scene no more than it needs (see compression.schedule), "fixed" what it has.
        dynamic_share: with "auto", the share of the Gaussians that are dynamic at most, whatever that costs; 0 for as
            many as have to be.
        fusion: of the temporal embeddings, see field.names.FUSIONS (FRoG, section on early fusion; its table compares
            them).
        embedding_size, temporal_size, hidden_width, head_width, deformed_sh, deformed_opacity: see model.frog.
        appearance_views: training images of a moment, in the mean, below which colours and opacities are the same at
            all times where each image is taken from another side (see ``views.fit_to``); 0 for never, as in the papers.
        modulation: see model.deformation; the papers have none.
        frames_per_row, pictures_per_row, most_temporal_rows: frames and training images for each row of the temporal
            table at least, and rows at most.
        coarse_share: the coarse embedding's share of the rows; 0 for half of them, at most 30. E-D3DGS has a fifth (150
            and 30 for 300 frames), which leaves short captures very few.
        opacity_reduction, opacity_sharpness: "paper", "unit" or "off", and the paper's k.
        opacity_ramp: fractions of training between which the reduction is ramped in.
        table_smoothness: weight of the temporal table's smoothness (E-D3DGS has 1e-4 for HyperNeRF); rows at held-out
            frames have nothing else to go by.
        fine_rows_until: fraction at which the fine temporal embedding has all its rows.
        warm_up: fraction of training without deformation.
        mean_rate ... grid_rate: Adam rates at the start; means, embedding, network, grid and temporal rates decay
            exponentially by ``rate_decay`` to the end, the others by ``attribute_decay``.
        cool_down: fraction of training, the last, over which all rates go down to nothing as well, linearly: steps as
            large as they were leave the scene a few tenths of a dB beside where they lead.
        pose_reach, pose_from: how far a training camera's pose may go in a training, as a share of its image's width,
            and the fraction of training at which it begins (see optimize.camera_refinement); the papers take poses as
            they are.
        exposure_from: fraction of training from which on training cameras' exposures are compared (see
            optimize.camera_refinement); 1 for never, as in the papers.
        square_weight: of the mean squared difference beside the mean absolute one; none where ``views.fit_to`` fixes
            appearance.
        dssim_weight: of (1 - SSIM) / 2, for ``dssim_burst`` of every ``dssim_period`` steps after ``dssim_from``
            (FRoG, section on optimisation: 5 of 50 after an eighth of the training).
        alpha_weight: of the mean difference in alpha, where images or masks say what it is.
        sides_sh_degree, sides_alpha_weight: ``sh_degree`` and ``alpha_weight`` at least, where ``appearance_views``
            applies: images from ever other sides show more of how a surface shines, and many silhouettes.
        size_weight: of the Gaussians' mean standard deviation, over the scene's scale, where ``appearance_views``
            applies; elsewhere ``views.fit_to`` makes it 0.
        size_limit, size_limit_from: largest standard deviation of a Gaussian, as a share of its distance to the nearest
            training camera, and the fraction of training from which on it holds (see optimize.gaussian_state); 0 for
            none, as in the papers.
        smoothness_weight, smoothness_neighbours, smoothness_falloff: embedding smoothness; the falloff (the paper's
            lambda_w) multiplies squared distances in units of the median nearest-neighbour distance.
        half_size_until: fraction of training in which images have half their size (see optimize.mattes).
        region_share, region_size, region_emphasis: probability that a step draws only a rectangle where the errors
            are, the rectangle's sides over the image's, and how much more its pixels weigh than a whole image's:
            with 0 a pixel weighs the same in every step, with 1 a step weighs the same (see optimize.schedule).
        densify_from, densify_until, densify_every: fractions.
        densify_threshold: mean screen gradient (in half image widths, as in 3DGS) above which a Gaussian splits.
        densify_growth: share of new Gaussians a round at most, see ``num_new``.
        replaced_below: largest recent blending weight below which a Gaussian is replaced by a new one when there are
            ``max_gaussians``; 0 for none, as in the papers.
        split_scale: above this size a Gaussian is split, below it is cloned.
        prune_opacity: canonical opacity below which a Gaussian is removed.
        sampling: "anchors" puts the points into the canonical field as they are (FRoG, section on canonical field
            sampling), "inverse" takes off the motion of the nearest Gaussian (the paper's inverse deformation), or
            "off".
        sampling_depth: "median" (the paper's) or "mean" depth along the pixel's ray.
        sampling_from, sampling_until, sampling_every: fractions; sampling_share: new anchors a round, see
            ``num_new``.
    """

    name: str = setting.name("standard")
    steps: int = whole(10_000, 1, _MOST_STEPS)
    steps_per_moment: int = whole(300, 0, 1_000_000)
    views_per_step: int = whole(1, 1, 1024)
    max_gaussians: int = whole(40_000, 1, _MOST_GAUSSIANS)
    kept_gaussians: int = whole(0, 0, _MOST_GAUSSIANS)
    seed_gaussians: int = whole(25_000, 1, _MOST_SEEDS)
    seed_share: float = number(1.0, 0, 1)
    moment_seeds: bool = flag(True)
    sh_degree: int = whole(1, 0, 3)
    sh_growth: tuple[float, ...] = fractions((0.1, 0.3, 0.5), 0, 3)
    capacity: str = choice("fixed", ("auto", "fixed"))
    dynamic_share: float = number(0.0, 0, 1)
    fusion: str = choice("product", FUSIONS)
    embedding_size: int = whole(32, 0, _WIDEST)
    temporal_size: int = whole(64, 1, _WIDEST)
    hidden_width: int = whole(64, 1, _WIDEST)
    head_width: int = whole(0, 0, _WIDEST)
    deformed_sh: int = choice(1, (0, 1, 4, 9, 16))
    deformed_opacity: bool = flag(True)
    appearance_views: float = number(1.5, 0, 1e6)
    modulation: bool = flag(True)
    frames_per_row: float = number(1.0, 1e-3, 1e6)
    pictures_per_row: float = number(2.0, 1e-3, 1e6, or_zero=True)
    most_temporal_rows: int = whole(150, 2, 10_000)
    coarse_share: float = number(0.0, 0, 1)
    table_smoothness: float = number(1e-4, 0, 1e3)
    opacity_reduction: str = choice("unit", FORMS)
    opacity_sharpness: float = number(10.0, 0, 1e3)
    opacity_ramp: tuple[float, float] = fractions((0.1, 0.25), 2, 2)
    fine_rows_until: float = number(0.05, 0, 1)
    warm_up: float = number(0.01, 0, 1)
    mean_rate: float = number(3e-4, 0, _FASTEST)
    scale_rate: float = number(4.5e-2, 0, _FASTEST)
    rotation_rate: float = number(2e-3, 0, _FASTEST)
    opacity_rate: float = number(3e-2, 0, _FASTEST)
    color_rate: float = number(5e-3, 0, _FASTEST)
    embedding_rate: float = number(3e-2, 0, _FASTEST)
    temporal_rate: float = number(1e-2, 0, _FASTEST)
    network_rate: float = number(1e-3, 0, _FASTEST)
    grid_rate: float = number(1e-2, 0, _FASTEST)
    rate_decay: float = number(0.1, 1e-9, 10)
    attribute_decay: float = number(0.2, 1e-9, 10)
    cool_down: float = number(0.15, 0, 1)
    pose_reach: float = number(0.01, 0, 1)
    pose_from: float = number(0.05, 0, 1)
    exposure_from: float = number(0.2, 0, 1)
    square_weight: float = number(10.0, 0, 1e4)
    dssim_weight: float = number(0.2, 0, 10)
    dssim_from: float = number(0.125, 0, _NEVER)
    dssim_burst: int = whole(5, 0, _MOST_STEPS)
    dssim_period: int = whole(50, 1, _MOST_STEPS)
    alpha_weight: float = number(0.1, 0, 10)
    sides_sh_degree: int = whole(2, 0, 3)
    sides_alpha_weight: float = number(1.0, 0, 10)
    size_weight: float = number(0.2, 0, 1e3)
    size_limit: float = number(0.2, 0, 1e6)
    size_limit_from: float = number(0.35, 0, 1)
    smoothness_weight: float = number(1e-3, 0, 1e3)
    smoothness_neighbours: int = whole(8, 1, 100)
    smoothness_falloff: float = number(0.3, 0, 1e6)
    smoothness_sample: int = whole(2048, 1, 100_000)
    half_size_until: float = number(0.4, 0, 1)
    region_share: float = number(0.75, 0, 1)
    region_size: float = number(0.35, 1e-3, 1)
    region_emphasis: float = number(0.5, 0, 1)
    densify_from: float = number(0.08, 0, _NEVER)
    densify_until: float = number(0.6, 0, _NEVER)
    densify_every: float = number(0.025, _OFTENEST, _NEVER)
    densify_threshold: float = number(2e-4, 0, 1e6)
    densify_growth: float = number(0.03, 0, 1)
    replaced_below: float = number(0.2, 0, 1)
    split_scale: float = number(0.01, 0, 1e6)
    prune_opacity: float = number(5e-3, 0, 1)
    sampling: str = choice("anchors", SAMPLINGS)
    sampling_depth: str = choice("median", ("median", "mean"))
    sampling_from: float = number(0.1, 0, _NEVER)
    sampling_until: float = number(0.7, 0, _NEVER)
    sampling_every: float = number(0.01, _OFTENEST, _NEVER)
    sampling_share: float = number(0.002, 0, 1)

    def steps_for(self, frames: int) -> int:
        """Steps for a capture of so many frames: more motion takes longer to learn."""
        return max(self.steps, self.steps_per_moment * frames)

    def temporal_rows_for(self, frames: int, images: int) -> int:
        """Rows of the temporal table for a capture of so many frames and training images."""
        rows = math.ceil(frames / self.frames_per_row)
        if self.pictures_per_row:
            rows = min(rows, int(images / self.pictures_per_row))
        return max(2, min(rows, self.most_temporal_rows))

    def coarse_rows_for(self, rows: int) -> int:
        """Rows of the coarse embedding, of a table of ``rows``."""
        share = self.coarse_share
        return max(2, min(rows, round(rows * share) if share else min(_MOST_COARSE_ROWS, rows // 2)))

    def moments_for(self, frames: int, images: int) -> int:
        """Times at which what moves has seed points: one for two of the coarse rows, since the temporal embedding
        begins with nothing faster. None where no Gaussian can be seen at a time of its own (see model.time_windows)."""
        if not (self.moment_seeds and self.modulation and self.deformed_opacity and self.embedding_size):
            return 0
        if self.head_width or network_count(self.fusion) > 1:
            return 0
        if self.temporal_size < self.embedding_size + WINDOW_COLUMNS:
            return 0
        return max(2, round(self.coarse_rows_for(self.temporal_rows_for(frames, images)) / 2))

    def growth_limit_at(self, progress: float) -> int:
        """Gaussians that a training grows to at ``progress``."""
        beyond = self.capacity == "auto" and progress >= _GROWN_FROM
        return int(_GROWN * self.max_gaussians) if beyond else self.max_gaussians

    @property
    def kept_at_most(self) -> int:
        """Gaussians that a scene has in the end."""
        return self.kept_gaussians or self.max_gaussians

    def num_new(self, count: int, share: float, while_few: float) -> int:
        """New Gaussians of a round: a share of those there are; where seeds were few ``while_few`` of half the limit,
        until there are as many, so that a scene that begins with a hundred points comes to its size in time."""
        half = self.max_gaussians // 2
        return int(share * count) if count >= half else int(max(share, while_few) * half)

    def __post_init__(self) -> None:
        check_all(self)
        if self.modulation and self.temporal_size < self.embedding_size:
            raise FrogError(
                f"temporal_size is {self.temporal_size}, expected at least embedding_size ({self.embedding_size})."
            )
        if len(self.sh_growth) < self.sh_degree:
            raise FrogError(f"sh_growth has {len(self.sh_growth)} fractions, expected {self.sh_degree} for sh_degree.")
        seeds = min(self.seed_gaussians, self.max_gaussians)
        numbers = 11 + 3 * (self.sh_degree + 1) ** 2 + self.embedding_size
        if seeds * numbers > _MOST_NUMBERS:
            raise FrogError(
                f"{seeds:,} seed points have {numbers:,} numbers each, expected at most {_MOST_NUMBERS:,} in all."
            )


# The paper's network and schedules for N3DV: five heads of 128, all SH deformed; made for a GPU and hours.
_PAPER = Recipe(
    name="paper",
    steps=80_000,
    steps_per_moment=0,
    max_gaussians=300_000,
    seed_gaussians=40_000,
    sh_degree=3,
    temporal_size=256,
    hidden_width=128,
    head_width=128,
    deformed_sh=16,
    moment_seeds=False,
    appearance_views=0.0,
    sides_sh_degree=0,
    sides_alpha_weight=0.0,
    size_weight=0.0,
    size_limit=0.0,
    modulation=False,
    frames_per_row=2.0,
    pictures_per_row=0.0,
    coarse_share=0.2,
    table_smoothness=0.0,
    opacity_reduction="paper",
    half_size_until=0.0,
    fine_rows_until=0.125,
    warm_up=0.0,
    opacity_ramp=(0.0625, 0.075),
    cool_down=0.0,
    mean_rate=4e-5,
    scale_rate=5e-3,
    pose_reach=0.0,
    exposure_from=1.0,
    square_weight=0.0,
    dssim_weight=1.0,
    densify_from=0.0625,
    densify_until=0.95,
    densify_every=100 / 80_000,
    densify_threshold=3e-4,
    replaced_below=0.0,
    smoothness_neighbours=20,
)

RECIPES = {
    "draft": Recipe(
        name="draft",
        steps=3_000,
        steps_per_moment=60,
        max_gaussians=25_000,
        seed_gaussians=20_000,
        embedding_rate=6e-2,
        rate_decay=0.25,
    ),
    "standard": Recipe(),
    "paper": _PAPER,
    # One moving camera; colours do not deform, no D-SSIM.
    "hypernerf": replace(
        _PAPER,
        name="hypernerf",
        steps=60_000,
        deformed_sh=0,
        most_temporal_rows=250,
        table_smoothness=1e-4,
        fine_rows_until=1 / 3,
        opacity_ramp=(0.1, 0.11),
        dssim_weight=0.0,
        densify_from=500 / 60_000,
        densify_every=100 / 60_000,
        densify_threshold=2e-4,
    ),
    # Fifty frames; colours do not deform, all rows from the start.
    "technicolor": replace(
        _PAPER,
        name="technicolor",
        steps=100_000,
        deformed_sh=0,
        fine_rows_until=0.0,
        opacity_ramp=(0.1, 0.11),
        dssim_from=0.1,
        densify_from=500 / 100_000,
        densify_every=100 / 100_000,
    ),
}


def stored_recipe(values: object) -> Recipe:
    """The recipe that ``settings_json`` made plain values of; FrogError for other values, and for missing ones."""
    if not isinstance(values, dict):
        raise FrogError(f"A recipe is {brief(repr(values))}, expected its settings by name.")
    if missing := kinds_of(Recipe).keys() - values.keys():
        raise FrogError(f"A recipe lacks {', '.join(sorted(missing))}, expected all of its settings.")
    return _changed(Recipe(), values)


def recipe(name: str, /, **overrides: Any) -> Recipe:
    """A named recipe with some settings changed; FrogError for a name that does not exist, or a value that is none."""
    if name not in RECIPES:
        raise FrogError(f"There is no recipe {name!r}; there are {', '.join(RECIPES)}.")
    return _changed(RECIPES[name], {key: value for key, value in overrides.items() if value is not None})


def _changed(base: Recipe, changes: Mapping[str, Any]) -> Recipe:
    """With lists, as JSON has them, for tuples."""
    known = kinds_of(Recipe)
    for key in changes:
        if key not in known:
            raise FrogError(f"A recipe has no setting {brief(repr(key))}.")
    values: dict[str, Any] = {key: tuple(each) if isinstance(each, list) else each for key, each in changes.items()}
    return replace(base, **values)
