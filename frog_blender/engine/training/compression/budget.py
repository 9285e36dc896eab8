"""Scenes within a budget of Gaussians or bytes: recipes that train them, and what is left out in the end."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from typing import TYPE_CHECKING

from ...errors import FrogError
from ...scene.quantization import BITS
from ..methods import method_named
from ..optimize.gaussian_order import arrange, mask_excluding
from ..recipe import Recipe
from .schedule import NUM_BUDGET_VIEWS, CompressionSchedule, CompressionStep

if TYPE_CHECKING:
    from ..optimize.trainer import Trainer

_MOVING_SHARE = 0.35  # of the Gaussians; what a training really puts to rest is known only at its end
_BYTES_AT_LEAST = 60.0  # of a Gaussian in a file, more than it takes: the first guess
_LEAST_GROWN = 1000  # Gaussians, whatever the budget: too many are left out by what they add
_REST_OF_FILE = 50_000  # bytes of header, network and temporal table, in the usual recipes


def with_budget(recipe: Recipe, count: int, method: str) -> Recipe:
    """A recipe whose scenes have ``count`` Gaussians at most.

    With automatic capacity a training grows as it would without a budget, to twice as many at most, and leaves out what
    adds least when it settles (``reductions.prune``). That is better than never having had them
    (docs/experiments/compression.md).
    """
    if method_named(method).adapt(recipe).capacity != "auto":
        return replace(recipe, max_gaussians=count)
    return replace(recipe, kept_gaussians=count, max_gaussians=max(count, min(recipe.max_gaussians, 2 * count)))


def gaussians_within(size: int, recipe: Recipe) -> int:
    """Gaussians of a packed file of about ``size`` bytes, for a training to grow to; what is too much in the end is
    left out then (``fit_within``)."""
    still = 3 * (BITS["means"] + BITS["log_scales"]) + 4 * BITS["quaternions"] + BITS["opacity_logits"]
    still += 3 * (recipe.sh_degree + 1) ** 2 * BITS["sh"]
    of_each = (still + _MOVING_SHARE * recipe.embedding_size * BITS["embeddings"]) / 8
    return max(_LEAST_GROWN, int((size - _REST_OF_FILE) / of_each))


def keep_within(rounds: CompressionSchedule, trainer: Trainer, most: int) -> None:
    """Leaves out what adds least until there are at most ``most`` Gaussians."""
    _leave_out(rounds, trainer, lambda: trainer.count - most)


def fit_within(rounds: CompressionSchedule, trainer: Trainer, size_of: Callable[[], int], most: int) -> None:
    """Leaves out what adds least until ``size_of()``, the bytes of the scene's file, is at most ``most``.

    FrogError when a file of a single Gaussian would be larger.
    """
    before, sizes = trainer.count, list[int]()

    def too_many() -> int:
        sizes.append(size_of())
        saved, gone = sizes[0] - sizes[-1], before - trainer.count
        of_each = max(1.0, saved / gone) if saved > 0 else _BYTES_AT_LEAST
        number = math.ceil((sizes[-1] - most) / of_each)
        if number > 0 and trainer.count == 1:
            raise FrogError(
                f"The budget of {most} bytes is too small: a single Gaussian takes {sizes[-1]}. The training is kept: "
                "resume it with a larger budget."
            )
        return min(number, (trainer.count + 1) // 2)  # what many have in common is not saved by each of them

    _leave_out(rounds, trainer, too_many, lambda: sizes[0] - sizes[-1])


def _leave_out(
    rounds: CompressionSchedule, trainer: Trainer, too_many: Callable[[], int], saved: Callable[[], int] = lambda: 0
) -> None:
    """Leaves out what all images together would lose least with, until there are not ``too_many()``.

    Args:
        saved: bytes, in the end.
    """
    generator = rounds.generator()
    before, number = trainer.count, too_many()
    if number <= 0:
        return
    psnr = rounds.judge(trainer).now
    while number > 0:
        measured = rounds.measure(trainer, rounds.sample_views(generator, NUM_BUDGET_VIEWS), generator)
        keep = mask_excluding(measured.energy.argsort()[:number], trainer.count).nonzero().squeeze(1)
        arrange(trainer, keep, keep[keep < trainer.model.canonical.num_dynamic])
        number = too_many()
    loss = psnr - rounds.judge(trainer).now
    rounds.reductions.append(CompressionStep("pruned", trainer.progress, before, trainer.count, loss, bytes=saved()))
