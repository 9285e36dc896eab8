"""Every setting of a training. Schedules are fractions of the training, so that a draft passes through all of it."""

from __future__ import annotations

import math
from dataclasses import dataclass, fields, replace
from typing import Any

from ..errors import FrogError
from ..model.choices import FORMS, FUSIONS

SAMPLINGS = ("anchors", "inverse", "off")
_MOST_COARSE_ROWS = 30
_GROWN, _GROWN_FROM = 1.075, 0.5
"""Times as many Gaussians as a scene keeps, with automatic capacity, before what pictures do not miss is left out; and
the fraction of the training before which there are no more than it keeps."""


@dataclass(frozen=True)
class Recipe:
    """How to train. Lengths are in world units times the scene's scale (median distance from camera to seed point).

    Attributes:
        name: "draft" or "standard"; "paper" (N3DV), "hypernerf" and "technicolor" follow the papers.
        steps: optimiser steps, each on one picture or part of it, at least.
        steps_per_moment: for each of the capture's moments; what is longer of the two is trained.
        max_gaussians: of a scene at most, see ``growth_limit_at``.
        kept_gaussians: of them, those that a scene has in the end at most, with automatic capacity; 0 for as many as it
            needs (see training.budget).
        seed_gaussians: seed points at most.
        seed_share: of the seed points, those that may be measured, see ``find_seeds``; for tests of stability.
        sh_degree: 0 to 3; grows by one at each of ``sh_growth`` (fractions of training).
        capacity: "auto" leaves a scene no more than it needs (see training.parsimony), "fixed" what it has.
        dynamic_share: with "auto", the share of the Gaussians that may move at most, whatever that costs; 0 for as many
            as have to.
        fusion: of the temporal embeddings, see model.choices.FUSIONS (FRoG, section on early fusion; its table compares
            them).
        embedding_size, temporal_size, hidden_width, head_width, deformed_sh, deformed_opacity: see model.frog.
        modulation: see model.deformation; the papers have none.
        frames_per_row, pictures_per_row, most_temporal_rows: frames and training pictures for each row of the temporal
            table at least, and rows at most.
        coarse_share: the coarse embedding's share of the rows; 0 for half of them, at most 30. E-D3DGS has a fifth (150
            and 30 for 300 frames), which leaves short captures very few.
        opacity_reduction, opacity_sharpness: "paper", "unit" or "off", and the paper's k.
        opacity_ramp: fractions of training between which the reduction is ramped in.
        table_smoothness: weight of the temporal table's smoothness (E-D3DGS has 1e-4 for HyperNeRF); rows at withheld
            moments have nothing else to go by.
        fine_rows_until: fraction at which the fine temporal embedding has all its rows.
        warm_up: fraction of training without deformation.
        mean_rate ... grid_rate: Adam rates at the start; means, embedding, network, grid and temporal rates decay
            exponentially by ``rate_decay`` to the end, the others by ``attribute_decay``.
        cool_down: fraction of training, the last, over which all rates go down to nothing as well, linearly: steps as
            large as they were leave the scene a few tenths of a dB beside where they lead.
        pose_reach, pose_from: how far a training camera's pose may go in a training, as a share of its picture's width,
            and the fraction of training at which it begins (see training.poses); the papers take poses as they are.
        exposure_from: fraction of training from which on training cameras' exposures are compared (see
            training.exposures); 1 for never, as in the papers.
        dssim_weight: of (1 - SSIM) / 2, for ``dssim_burst`` of every ``dssim_period`` steps after ``dssim_from``
            (FRoG, section on optimisation: 5 of 50 after an eighth of the training).
        smoothness_weight, smoothness_neighbours, smoothness_falloff: embedding smoothness; the falloff (the paper's
            lambda_w) multiplies squared distances in units of the median nearest-neighbour distance.
        frame_choice: "even" draws every training picture alike; "loss" draws every second moment in proportion to its
            last loss (E-D3DGS's loss-based frame sampling).
        half_size_until: fraction of training in which pictures have half their size (see training.resolution).
        region_share, region_size, region_emphasis: probability that a step draws only a rectangle where the errors
            are, the rectangle's sides over the picture's, and how much more its pixels weigh than a whole picture's:
            with 0 a pixel weighs the same in every step, with 1 a step weighs the same (see training.regions).
        densify_from, densify_until, densify_every: fractions.
        densify_threshold: mean screen gradient (in half picture widths, as in 3DGS) above which a Gaussian splits.
        densify_growth: share of new Gaussians a round at most, see ``newcomers``.
        replaced_below: largest blending weight of late below which a Gaussian makes room for a new one when there are
            ``max_gaussians``; 0 for none, as in the papers.
        split_scale: above this size a Gaussian is split, below it is cloned.
        prune_opacity: canonical opacity below which a Gaussian is removed.
        sampling: "anchors" puts the points into the canonical field as they are (FRoG, section on canonical field
            sampling), "inverse" takes off the motion of the nearest Gaussian (the paper's inverse deformation), or
            "off".
        sampling_depth: "median" (the paper's) or "mean" depth along the pixel's ray.
        sampling_from, sampling_until, sampling_every: fractions; sampling_share: new anchors a round, see
            ``newcomers``.
    """

    name: str = "standard"
    steps: int = 10_000
    steps_per_moment: int = 300
    max_gaussians: int = 40_000
    kept_gaussians: int = 0
    seed_gaussians: int = 25_000
    seed_share: float = 1.0
    sh_degree: int = 1
    sh_growth: tuple[float, ...] = (0.1, 0.3, 0.5)
    capacity: str = "fixed"
    dynamic_share: float = 0.0
    fusion: str = "product"
    embedding_size: int = 32
    temporal_size: int = 64
    hidden_width: int = 64
    head_width: int = 0
    deformed_sh: int = 1
    deformed_opacity: bool = True
    modulation: bool = True
    frames_per_row: float = 1.0
    pictures_per_row: float = 2.0
    most_temporal_rows: int = 150
    coarse_share: float = 0.0
    table_smoothness: float = 1e-4
    opacity_reduction: str = "unit"
    opacity_sharpness: float = 10.0
    opacity_ramp: tuple[float, float] = (0.1, 0.25)
    fine_rows_until: float = 0.05
    warm_up: float = 0.01
    mean_rate: float = 3e-4
    scale_rate: float = 4.5e-2
    rotation_rate: float = 2e-3
    opacity_rate: float = 3e-2
    color_rate: float = 5e-3
    embedding_rate: float = 3e-2
    temporal_rate: float = 1e-2
    network_rate: float = 1e-3
    grid_rate: float = 1e-2
    rate_decay: float = 0.1
    attribute_decay: float = 0.2
    cool_down: float = 0.15
    pose_reach: float = 0.01
    pose_from: float = 0.05
    exposure_from: float = 0.2
    dssim_weight: float = 0.2
    dssim_from: float = 0.125
    dssim_burst: int = 5
    dssim_period: int = 50
    smoothness_weight: float = 1e-3
    smoothness_neighbours: int = 8
    smoothness_falloff: float = 0.3
    smoothness_sample: int = 2048
    frame_choice: str = "even"
    half_size_until: float = 0.4
    region_share: float = 0.75
    region_size: float = 0.35
    region_emphasis: float = 0.5
    densify_from: float = 0.08
    densify_until: float = 0.6
    densify_every: float = 0.025
    densify_threshold: float = 2e-4
    densify_growth: float = 0.03
    replaced_below: float = 0.2
    split_scale: float = 0.01
    prune_opacity: float = 5e-3
    sampling: str = "anchors"
    sampling_depth: str = "median"
    sampling_from: float = 0.1
    sampling_until: float = 0.7
    sampling_every: float = 0.01
    sampling_share: float = 0.002

    def steps_for(self, moments: int) -> int:
        """Steps for a capture of so many moments: motion takes time to learn, and more of it more time."""
        return max(self.steps, self.steps_per_moment * moments)

    def temporal_rows_for(self, frames: int, pictures: int) -> int:
        """Rows of the temporal table for a capture of so many moments and training pictures."""
        rows = math.ceil(frames / self.frames_per_row)
        if self.pictures_per_row:
            rows = min(rows, int(pictures / self.pictures_per_row))
        return max(2, min(rows, self.most_temporal_rows))

    def coarse_rows_for(self, rows: int) -> int:
        """Rows of the coarse embedding, of a table of ``rows``."""
        share = self.coarse_share
        return max(2, min(rows, round(rows * share) if share else min(_MOST_COARSE_ROWS, rows // 2)))

    def growth_limit_at(self, progress: float) -> int:
        """Gaussians that a training grows to at ``progress``."""
        beyond = self.capacity == "auto" and progress >= _GROWN_FROM
        return int(_GROWN * self.max_gaussians) if beyond else self.max_gaussians

    @property
    def kept_at_most(self) -> int:
        """Gaussians that a scene has in the end."""
        return self.kept_gaussians or self.max_gaussians

    def newcomers(self, count: int, share: float, while_few: float) -> int:
        """New Gaussians of a round: a share of those there are; where seeds were few ``while_few`` of half the limit,
        until there are as many, so that a scene that begins with a hundred points comes to its size in time."""
        half = self.max_gaussians // 2
        return int(share * count) if count >= half else int(max(share, while_few) * half)

    def __post_init__(self) -> None:
        for name, known in _CHOICES.items():
            if getattr(self, name) not in known:
                raise FrogError(f"{name} is {getattr(self, name)!r}, expected one of {', '.join(known)}.")
        if not 0 <= self.sh_degree <= 3 or self.deformed_sh not in (0, 1, 4, 9, 16):
            raise FrogError("sh_degree must be 0 to 3, and deformed_sh 0, 1, 4, 9 or 16.")
        if self.modulation and self.temporal_size < self.embedding_size:
            raise FrogError(
                f"temporal_size is {self.temporal_size}, expected at least embedding_size ({self.embedding_size})."
            )
        if not 0 <= self.seed_share <= 1:
            raise FrogError(f"seed_share is {self.seed_share}, expected 0 to 1.")
        if not 0 <= self.cool_down <= 1:
            raise FrogError(f"cool_down is {self.cool_down}, expected 0 to 1.")
        if self.steps < 1:
            raise FrogError(f"The number of steps is {self.steps}, expected at least 1.")


_CHOICES = {
    "capacity": ("auto", "fixed"),
    "fusion": FUSIONS,
    "opacity_reduction": FORMS,
    "sampling": SAMPLINGS,
    "sampling_depth": ("median", "mean"),
    "frame_choice": ("even", "loss"),
}

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
    # Fifty moments; colours do not deform, all rows from the start.
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


def stored_recipe(values: dict[str, Any]) -> Recipe:
    """The recipe that ``settings_json`` made plain values of; TypeError, ValueError or FrogError for other values."""
    settings: dict[str, Any] = {key: tuple(each) if isinstance(each, list) else each for key, each in values.items()}
    _check_kinds(settings)
    return Recipe(**settings)


def _check_kinds(settings: dict[str, Any]) -> None:
    """ValueError for a value of another kind than the setting's."""
    for field in fields(Recipe):
        kind = type(field.default)
        if not isinstance(settings.get(field.name, field.default), (int, float) if kind is float else kind):
            raise ValueError(f"{field.name} is {settings[field.name]!r}, expected {kind.__name__}")


def recipe(name: str, **overrides: Any) -> Recipe:
    """A named recipe with some settings changed; FrogError for a name that does not exist, or a value that is none."""
    if name not in RECIPES:
        raise FrogError(f"There is no recipe {name!r}; there are {', '.join(RECIPES)}.")
    known = {field.name for field in fields(Recipe)}
    for key in overrides:
        if key not in known:
            raise FrogError(f"A recipe has no setting {key!r}.")
    changes = {key: value for key, value in overrides.items() if value is not None}
    try:
        _check_kinds(changes)
    except ValueError as error:
        raise FrogError(f"A recipe's {error}.") from error
    return replace(RECIPES[name], **changes)
