"""Every setting of a training. Schedules are fractions of the training, so that a draft passes through all of it."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

from .errors import FrogError, UsageError, brief, named, told_as
from .field.names import FORMS, FUSIONS, WINDOW_COLUMNS, network_count
from .gaussians import LOW_PASS, WIDEST_LOW_PASS
from .registry import DENSITY, LOSSES, RASTERIZERS
from .setting import (
    Choice,
    Name,
    Weights,
    check_all,
    choice,
    flag,
    fractions,
    meanings_of,
    nearest,
    number,
    plain,
    setting,
    whole,
)

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
    """How to train, each setting with its range and its meaning. Lengths are in world units times the scene's scale
    (median distance from camera to seed point); "until", "from" and "every" are fractions of the training."""

    name: str = setting("standard", Name(), "what it is called; those in -exact follow the paper and its code")

    steps: int = whole(
        10_000,
        1,
        _MOST_STEPS,
        "optimiser steps at least, each on an image or a part of it",
        group="Length",
    )
    steps_per_moment: int = whole(
        300, 0, 1_000_000, "steps for each of the capture's frames; what is longer of the two is trained"
    )

    max_gaussians: int = whole(40_000, 1, _MOST_GAUSSIANS, "Gaussians of a scene at most", group="Gaussians")
    kept_gaussians: int = whole(
        0, 0, _MOST_GAUSSIANS, "of them, those kept in the end with automatic capacity; 0 for as many as it needs"
    )
    seed_gaussians: int = whole(25_000, 1, _MOST_SEEDS, "seed points at most")
    seed_share: float = number(1.0, 0, 1, "share of the seed points that may be measured; for tests of stability")
    low_pass: float = number(
        0.1, 0, WIDEST_LOW_PASS, "variance in pixels squared that drawing adds to every splat (0.3 in 3DGS)"
    )
    least_size: float = number(
        0.45, 0, 10, "smallest standard deviation, in pixels of the training camera that sees it finest; 0 for none"
    )
    near_share: float = number(
        0.65,
        0,
        1,
        "nearest that a Gaussian may be to a training camera, as a share of its nearest seed points' distance; 0: any",
    )
    moment_seeds: bool = flag(
        True,
        "what moves before eight static cameras or more has seed points at many times, each seen at its own at first",
    )
    sh_degree: int = whole(1, 0, 3, "of the spherical harmonics, grown to by one at each of sh_growth")
    sh_growth: tuple[float, ...] = fractions((0.1, 0.3, 0.5), 0, 3, "when, one fraction for each degree at least")
    capacity: str = choice(
        "fixed",
        ("auto", "fixed"),
        "auto leaves a scene no more than it needs, fixed what it has (compression.schedule)",
    )
    dynamic_share: float = number(
        0.0,
        0,
        1,
        "with automatic capacity, share of the Gaussians that are dynamic at most; 0 for as many as have to be",
    )

    fusion: str = choice("product", FUSIONS, "of the temporal embeddings (field.names.FUSIONS)", group="Deformation")
    embedding_size: int = whole(32, 0, _WIDEST, "numbers of each Gaussian's embedding")
    temporal_size: int = whole(64, 1, _WIDEST, "numbers of a temporal embedding")
    hidden_width: int = whole(64, 1, _WIDEST, "units of the network's hidden layer")
    head_width: int = whole(0, 0, _WIDEST, "units of a head's own hidden layer; 0 for none")
    deformed_sh: int = choice(1, (0, 1, 4, 9, 16), "spherical harmonics that the network deforms")
    deformed_opacity: bool = flag(True, "the network deforms opacities")
    appearance_views: float = number(
        1.5,
        0,
        1e6,
        "training images a moment below which colours and opacities stay the same, if all sides differ; 0: never",
    )
    modulation: bool = flag(True, "first layer with products of time and embedding; the papers have none")
    frames_per_row: float = number(1.0, 1e-3, 1e6, "frames for each row of the temporal table at least")
    pictures_per_row: float = number(2.0, 1e-3, 1e6, "training images for each row at least", or_zero=True)
    most_temporal_rows: int = whole(150, 2, 10_000, "rows of the temporal table at most")
    coarse_share: float = number(
        0.0, 0, 1, "the coarse embedding's share of the rows; 0 for half of them, at most 30 (E-D3DGS: a fifth)"
    )
    table_smoothness: float = number(1e-4, 0, 1e3, "weight of the temporal table's smoothness, for rows without images")
    opacity_reduction: str = choice("unit", FORMS, "how the network reduces opacity (model.opacity)")
    opacity_sharpness: float = number(10.0, 0, 1e3, "the k of the reduction")
    opacity_ramp: tuple[float, float] = fractions((0.1, 0.25), 2, 2, "between which the reduction is ramped in")
    fine_rows_until: float = number(0.05, 0, 1, "by when the fine temporal embedding has all its rows")
    warm_up: float = number(0.01, 0, 1, "fraction of the training without deformation")

    mean_rate: float = number(3e-4, 0, _FASTEST, "Adam rate of the means at the start", group="Rates")
    scale_rate: float = number(4.5e-2, 0, _FASTEST, "of the log scales")
    rotation_rate: float = number(2e-3, 0, _FASTEST, "of the quaternions")
    opacity_rate: float = number(3e-2, 0, _FASTEST, "of the opacity logits")
    color_rate: float = number(5e-3, 0, _FASTEST, "of the spherical harmonics")
    embedding_rate: float = number(3e-2, 0, _FASTEST, "of the Gaussians' embeddings")
    temporal_rate: float = number(1e-2, 0, _FASTEST, "of the temporal table")
    network_rate: float = number(1e-3, 0, _FASTEST, "of the network")
    grid_rate: float = number(1e-2, 0, _FASTEST, "of a grid (4DGaussians)")
    rate_decay: float = number(0.1, 1e-9, 10, "what rates of means, embeddings, network, grid and table decay to")
    mean_decay: float = number(0.0, 0, 10, "what the rate of the means decays to; 0 for rate_decay")
    attribute_decay: float = number(0.2, 1e-9, 10, "what the other rates decay to")
    cool_down: float = number(
        0.15, 0, 1, "last fraction of the training, over which all rates go down to nothing, linearly"
    )

    pose_reach: float = number(
        0.01,
        0,
        1,
        "how far a camera's pose may be refined, as a share of its image's width (0 in the papers)",
        group="Cameras",
    )
    pose_from: float = number(0.05, 0, 1, "from when on poses are refined")
    exposure_from: float = number(
        0.2, 0, 1, "from when on cameras' exposures are compared; 1 for never, as in the papers"
    )

    square_weight: float = number(
        10.0,
        0,
        1e4,
        "of the mean squared difference beside the absolute one; none where appearance is fixed",
        group="Loss",
    )
    dssim_weight: float = number(0.2, 0, 10, "of (1 - SSIM) / 2, in a burst of steps of every period (FRoG: 5 of 50)")
    dssim_from: float = number(0.125, 0, _NEVER, "from when on")
    dssim_burst: int = whole(5, 0, _MOST_STEPS, "steps of a burst")
    dssim_period: int = whole(50, 1, _MOST_STEPS, "steps of a period")
    alpha_weight: float = number(0.1, 0, 10, "of the mean difference in alpha, where images or masks say what it is")
    sides_sh_degree: int = whole(2, 0, 3, "sh_degree at least, where appearance_views applies")
    sides_alpha_weight: float = number(1.0, 0, 10, "alpha_weight at least, where appearance_views applies")
    sides_smoothness: float = number(0.1, 0, 1e3, "smoothness_weight at least, where appearance_views applies")
    size_weight: float = number(0.2, 0, 1e3, "of the mean standard deviation, where appearance_views applies")
    size_limit: float = number(
        0.2, 0, 1e6, "largest standard deviation, as a share of the distance to the nearest camera; 0 for none"
    )
    size_limit_from: float = number(0.35, 0, 1, "from when on")
    smoothness_weight: float = number(1e-3, 0, 1e3, "of the difference between neighbours' embeddings")
    smoothness_neighbours: int = whole(8, 1, 100, "neighbours of each Gaussian")
    smoothness_falloff: float = number(
        0.3, 0, 1e6, "the paper's lambda_w, for squared distances in units of the median nearest-neighbour distance"
    )
    smoothness_sample: int = whole(2048, 1, 100_000, "Gaussians that a step looks at")

    half_size_until: float = number(0.4, 0, 1, "until when images have half their size", group="Images")
    region_share: float = number(0.75, 0, 1, "probability that a step draws only a rectangle, where the errors are")
    region_size: float = number(0.35, 1e-3, 1, "the rectangle's sides over the image's")
    region_emphasis: float = number(
        0.5, 0, 1, "its weight: with 0 a pixel weighs the same in every step, with 1 a step weighs the same"
    )

    densify_from: float = number(0.08, 0, _NEVER, "from when on Gaussians are added", group="Densification")
    densify_until: float = number(0.6, 0, _NEVER, "until when")
    densify_every: float = number(0.025, _OFTENEST, _NEVER, "how often")
    densify_threshold: float = number(
        2e-4, 0, 1e6, "mean screen gradient, in half image widths, above which one splits"
    )
    densify_growth: float = number(0.03, 0, 1, "share of new ones a round at most")
    replaced_below: float = number(
        0.2, 0, 1, "recent blending weight below which one is replaced, when there are max_gaussians; 0 for none"
    )
    split_scale: float = number(0.01, 0, 1e6, "size above which one is split; below it is cloned")
    prune_opacity: float = number(5e-3, 0, 1, "canonical opacity below which one is removed")

    sampling: str = choice(
        "anchors",
        SAMPLINGS,
        "of the canonical field: anchors as they are, inverse without the nearest one's motion, or off",
        group="Sampling",
    )
    sampling_depth: str = choice("median", ("median", "mean"), "depth along the pixel's ray; the paper's is the median")
    sampling_error: str = choice(
        "relative", ("relative", "l1"), "of pixels: over their brightness, with what nothing covers, or the paper's"
    )
    sampling_from: float = number(0.1, 0, _NEVER, "from when on")
    sampling_until: float = number(0.7, 0, _NEVER, "until when")
    sampling_every: float = number(0.01, _OFTENEST, _NEVER, "how often")
    sampling_share: float = number(0.002, 0, 1, "new anchors a round, as a share of the Gaussians")

    density: str = setting(
        "adaptive", Choice(lambda: tuple(DENSITY)), "strategy that adds and removes Gaussians", group="Of packages"
    )
    losses: str = setting("", Weights(LOSSES, 1e4), "terms of the loss besides, as NAME:WEIGHT,NAME:WEIGHT")
    rasterizer: str = setting(
        "auto",
        Choice(lambda: ("auto", *RASTERIZERS)),
        "what draws; auto is the fastest on the device, and with any other a model is computed by torch alone",
    )

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


# The paper for N3DV, and where it is silent E-D3DGS's code, on which it stands: see docs/experiments/paper.md. Five
# heads of 128, all SH deformed; made for a GPU and hours. Rates of networks are 1.6e-4 times the extent of the rig.
_PAPER = Recipe(
    name="paper-exact",
    steps=80_000,
    steps_per_moment=0,
    max_gaussians=300_000,
    seed_gaussians=40_000,
    low_pass=LOW_PASS,
    least_size=0.0,
    near_share=0.0,
    sh_degree=3,
    sh_growth=(1 / 80, 2 / 80, 3 / 80),
    temporal_size=256,
    hidden_width=128,
    head_width=128,
    deformed_sh=16,
    moment_seeds=False,
    appearance_views=0.0,
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
    opacity_ramp=(0.0, 0.0),
    cool_down=0.0,
    mean_rate=4e-5,
    scale_rate=5e-3,
    rotation_rate=1e-3,
    opacity_rate=5e-2,
    color_rate=2.5e-3,
    embedding_rate=2.5e-3,
    temporal_rate=1e-3,
    mean_decay=0.01,
    attribute_decay=1.0,
    pose_reach=0.0,
    exposure_from=1.0,
    square_weight=0.0,
    dssim_weight=1.0,
    sampling_error="l1",
    region_share=0.0,
    densify_from=0.0625,
    densify_until=1.0,
    densify_every=100 / 80_000,
    densify_threshold=3e-4,
    densify_growth=1.0,
    replaced_below=0.0,
    smoothness_weight=1.0,
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
    "paper-exact": _PAPER,
    # One moving camera; colours do not deform.
    "hypernerf-exact": replace(
        _PAPER,
        name="hypernerf-exact",
        steps=60_000,
        sh_growth=(1 / 60, 2 / 60, 3 / 60),
        deformed_sh=0,
        most_temporal_rows=250,
        table_smoothness=1e-4,
        fine_rows_until=1 / 3,
        deformed_opacity=False,
        dssim_from=1 / 6,
        densify_from=500 / 60_000,
        densify_every=100 / 60_000,
        densify_threshold=2e-4,
    ),
    # Fifty frames; colours do not deform, all rows from the start.
    "technicolor-exact": replace(
        _PAPER,
        name="technicolor-exact",
        steps=100_000,
        sh_growth=(0.01, 0.02, 0.03),
        deformed_sh=0,
        fine_rows_until=0.0,
        temporal_rate=1e-2,
        network_rate=1e-2,
        dssim_from=0.1,
        densify_from=500 / 100_000,
        densify_every=100 / 100_000,
        smoothness_weight=0.1,
    ),
}


_FORMER = {"views_per_step": 1}
"""Settings that recipes had, and what is done now."""


def stored_recipe(values: object) -> Recipe:
    """The recipe that ``settings_json`` made plain values of; FrogError for other values, and for missing ones.
    Settings that recipes no longer have are left out where they said what is always done now."""
    if not isinstance(values, dict):
        raise FrogError(f"A recipe is {brief(repr(values))}, expected its settings by name.")
    values = {name: value for name, value in values.items() if name not in _FORMER or value != _FORMER[name]}
    if missing := meanings_of(Recipe).keys() - values.keys():
        raise FrogError(f"A recipe lacks {', '.join(sorted(missing))}, expected all of its settings.")
    return _changed(Recipe(), values)


@told_as(UsageError)
def recipe(base: str | Recipe, /, **changes: Any) -> Recipe:
    """A recipe, or the one of that name, with some settings changed; None changes nothing.

    Raises:
        FrogError: for a name that does not exist, or a value that a setting does not take.
    """
    if not isinstance(base, Recipe):
        base = named("recipe", str(base), RECIPES)
    return _changed(base, {name: value for name, value in changes.items() if value is not None})


def _changed(base: Recipe, changes: Mapping[str, Any]) -> Recipe:
    """With lists, as JSON has them, for tuples."""
    known = tuple(meanings_of(Recipe))
    for name in changes:
        if name not in known:
            raise FrogError(f"A recipe has no setting {brief(repr(name))}{nearest(str(name), known)}")
    return replace(base, **plain(changes))
