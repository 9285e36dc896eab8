"""Compression passes: prune, reduce the SH degree, freeze.

A pass yields proposals. ``CompressionContext.compress`` applies each only as far as the validation loss stays within
its tolerance, or as a budget requires, and logs what it saved. A pass goes on from what was taken.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import torch

from ...capture.seeding.views import spread
from ...scene.compression_report import StepKind
from ..optimize import gaussian_order
from ..optimize.gaussian_order import mask_excluding
from ..optimize.stateful import Tensors
from .context import CompressionContext, Proposal
from .sensitivity import Sensitivity, in_state, peak_weights
from .static_regions import change_of_pixels, temporal_variance
from .validation import ValidationEvaluator


def prune(context: CompressionContext, evaluator: ValidationEvaluator, measured: Sensitivity) -> Iterator[Proposal]:
    """Gaussians that images do not need, or that the limit has no room for.

    What no image may miss is ordered by the image that would miss it most; where a budget forces, by what all of them
    together would.
    """
    training, gaussians, settings = context.training, context.training.gaussians, context.settings
    count, recipe = gaussians.count, training.recipe
    forced = count - recipe.kept_at_most
    order = (measured.energy if forced > 0 and recipe.kept_gaussians else measured.contribution).argsort()
    yield replace(
        _pruning(context, evaluator, order),
        allowed=settings.max_prune_loss,
        expected=evaluator.expected(measured.energy[order[: int(settings.max_pruned * count)]]),
        forced=forced,
    )


def prune_unmissed(
    context: CompressionContext, evaluator: ValidationEvaluator, measured: Sensitivity
) -> Iterator[Proposal]:
    """Gaussians that hardly make a part of any training image: from elsewhere they are fog. What a single camera sees
    as a surface is most of what that camera sees there.

    Those go first that hide most for what images lose: a few large ones make up most of what is seen from outside.
    What costs too much alone is left out, or nothing behind it would go.
    """
    gaussians, capture, settings = context.training.gaussians, context.training.capture, context.settings
    shots = spread(capture.train_indices, settings.num_weight_views)
    faint = peak_weights(context.gaussians_at, capture, shots) < settings.unmissed_weight
    faint &= measured.energy < evaluator.energy_of(settings.max_unmissed_loss)
    drawn = context.gaussians_at(0.5)
    hidden = drawn.opacities * drawn.scales.sort(1).values[:, 1:].prod(1)
    loss = measured.energy / hidden.clamp(min=torch.finfo(hidden.dtype).tiny)
    order = torch.where(faint, loss, torch.inf).argsort()[: int(faint.sum())]
    if 0 < len(order) < gaussians.count:
        yield replace(
            _pruning(context, evaluator, order),
            allowed=settings.max_unmissed_loss,
            expected=evaluator.expected(measured.energy[order]),
        )


def _pruning(context: CompressionContext, evaluator: ValidationEvaluator, order: torch.Tensor) -> Proposal:
    """Removing the first of ``order``."""
    training, gaussians = context.training, context.training.gaussians
    count = gaussians.count

    def loss(number: int) -> float:
        there = mask_excluding(order[:number], count)
        return evaluator.loss(lambda drawn: replace(drawn, opacities=drawn.opacities * there))

    def apply(number: int) -> None:
        keep = mask_excluding(order[:number], count)
        removed = gaussians.canonical.means.detach()[~keep].cpu().numpy()
        context.record.removed = np.concatenate([context.record.removed, removed])
        gaussians.keep(keep.nonzero().squeeze(1))

    return Proposal(
        StepKind.PRUNE,
        apply,
        lambda: gaussians.count,
        loss,
        lambda: training.render_image(context.record.evaluated[0]),
    )


def reduce_sh_degree(context: CompressionContext, evaluator: ValidationEvaluator) -> Iterator[Proposal]:
    """The highest degrees of spherical harmonics, one after the other, within one tolerance for all together."""
    training, gaussians = context.training, context.training.gaussians
    allowed = context.settings.max_sh_loss

    def degree() -> int:
        return math.isqrt(gaussians.canonical.sh.shape[1]) - 1

    while (left := degree() ** 2) and left >= training.recipe.deformed_sh:

        def loss(number: int, left: int = left) -> float:
            return evaluator.loss(lambda drawn: replace(drawn, sh=drawn.sh[:, :left].contiguous()))

        def apply(number: int, left: int = left) -> None:
            gaussians.optimizer.reduce_sh_degree(left)

        before = evaluator.now
        yield Proposal(
            StepKind.SH_DEGREE,
            apply,
            degree,
            loss,
            lambda: training.render_image(context.record.evaluated[0]),
            allowed,
        )
        if degree() ** 2 == left:  # refused
            return
        allowed -= before - evaluator.now


def freeze_motion(context: CompressionContext, evaluator: ValidationEvaluator, allowed: float) -> Iterator[Proposal]:
    """Dynamic Gaussians whose motion images miss least, in their mean state: for ``allowed`` dB at most, and none whose
    motion can be seen but for what ``dynamic_share`` forces."""
    motion, gaussians, settings = context.record.motion, context.training.gaussians, context.settings
    before = context.num_dynamic
    if not before or motion is None:
        return
    all_may = float(motion.score.max()) < settings.freeze_all_score
    may = motion.score < (settings.freeze_all_score if all_may else settings.freeze_score)
    by_energy = motion.rest_energy.argsort()
    order = torch.cat([by_energy[may[by_energy]], by_energy[~may[by_energy]]])
    share = context.training.recipe.dynamic_share
    yield replace(
        _freezing(context, evaluator, order, context.record.mean_state),
        expected=evaluator.expected(motion.rest_energy[order[: int(may.sum())]]),
        allowed=allowed,
        forced=before - int(share * gaussians.count) if share else 0,
    )


def freeze_static_regions(
    context: CompressionContext, evaluator: ValidationEvaluator, generator: torch.Generator
) -> Iterator[Proposal]:
    """Dynamic Gaussians where the images hardly change, while motion is still being learned: all of them or none. Few
    are not worth disturbing a training that still finds its motion."""
    training, settings, before = context.training, context.settings, context.num_dynamic
    variance = temporal_variance(training.capture, training.store) if before else {}
    views = [view for view in context.sample_views(generator) if view.camera in variance]
    if not views:
        return
    change = change_of_pixels(context.gaussians_at, training.capture, views, variance)[:before]
    static = (change < settings.static_deviation**2).nonzero().squeeze(1)
    if len(static) > settings.min_frozen * before:
        yield replace(
            _freezing(context, evaluator, static, context.mean_dynamic_state(views)),
            expected=np.zeros(len(static)),
            allowed=settings.max_freeze_loss,
        )


def _freezing(
    context: CompressionContext, evaluator: ValidationEvaluator, order: torch.Tensor, state: Tensors
) -> Proposal:
    """Freezing the first of ``order``, dynamic Gaussians, in ``state`` (of all dynamic ones)."""
    gaussians = context.training.gaussians
    before = gaussians.num_dynamic
    drawn = {
        "means": state["means"],
        "quaternions": state["quaternions"],
        "scales": state["log_scales"].exp(),
        "opacities": state["opacity_logits"].sigmoid(),
        "sh": state["sh"][:, : gaussians.canonical.sh.shape[1]],
    }

    def loss(number: int) -> float:
        chosen = ~mask_excluding(order[:number], before)
        return evaluator.loss(lambda all_: in_state(all_, chosen, drawn))

    return Proposal(
        StepKind.FREEZE,
        lambda number: gaussian_order.freeze_motion(gaussians, order[:number].sort().values, state),
        lambda: gaussians.num_dynamic,
        loss,
        lambda: context.gaussians_at(0.5),
    )
