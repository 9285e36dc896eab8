"""Compression passes: prune, reduce the SH degree, freeze, unfreeze.

A pass yields proposals. ``CompressionContext.compress`` applies each only as far as the validation loss stays within
its tolerance, or as a budget requires, and logs what it saved. A pass goes on from what was taken.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import torch

from ...scene.compression_report import StepKind
from ..optimize import gaussian_order
from ..optimize.device import image_on
from ..optimize.gaussian_order import calmest_embedding, mask_excluding
from ..optimize.half_resolution import halved_capture, sized
from ..optimize.stateful import Tensors
from .context import CompressionContext, Proposal
from .sensitivity import Sensitivity, in_state
from .static_regions import measure_temporal_variance
from .temporal_residual import static_error, temporal_error_std
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

    def loss(number: int) -> float:
        there = mask_excluding(order[:number], count)
        return evaluator.loss(lambda drawn: replace(drawn, opacities=drawn.opacities * there))

    def apply(number: int) -> None:
        keep = mask_excluding(order[:number], count)
        removed = gaussians.canonical.means.detach()[~keep].cpu().numpy()
        context.record.removed = np.concatenate([context.record.removed, removed])
        gaussians.keep(keep.nonzero().squeeze(1))

    yield Proposal(
        StepKind.PRUNE,
        apply,
        lambda: gaussians.count,
        loss,
        evaluator.expected(measured.energy[order[: int(settings.max_pruned * count)]]),
        settings.max_prune_loss,
        forced,
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
            allowed=allowed,
            work=lambda: training.render_image(context.record.evaluated[0]),
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
    """Dynamic Gaussians where the images hardly change, while motion is still being learned: those whose pixels change
    least, none whose change can be seen, as many as add no more than a small part to the images' error. Few are not
    worth disturbing a training that still finds its motion."""
    training, settings = context.training, context.settings
    before = context.num_dynamic
    variance = measure_temporal_variance(training.capture, training.store) if before else None
    if not variance or variance.static_share(settings.static_deviation) < settings.min_static_area:
        return
    views = [view for view in context.sample_views(generator) if view.camera in variance.variance]
    if not views:
        return
    cameras = [training.capture.cameras[view.camera] for view in views]
    pixel_count = sum(camera.width * camera.height for camera in cameras)
    allowed = settings.static_error * 10 ** (-evaluator.now / 10) * pixel_count
    found = static_error(context.gaussians_at, training.capture, views, variance)
    pixels, lost = (values[:before] for values in found)
    each = torch.where(pixels >= 1, lost / pixels, torch.inf)
    order = each.argsort()
    number = int(((lost[order].cumsum(0) <= allowed) & (each[order] < settings.static_deviation**2)).sum())
    if number < max(1, settings.min_frozen * before):
        return
    freezing = _freezing(context, evaluator, order[:number], context.mean_dynamic_state(views))
    loss, apply = freezing.loss, freezing.apply
    assert loss is not None
    yield replace(
        freezing, apply=lambda _: apply(number), loss=lambda _: loss(number), allowed=settings.max_freeze_loss
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
        work=lambda: context.gaussians_at(0.5),
    )


def unfreeze_high_error(context: CompressionContext, generator: torch.Generator) -> Iterator[Proposal]:
    """Static Gaussians around which the error changes with time, as half the pixels a side show it."""
    training, gaussians, settings = context.training, context.training.gaussians, context.settings
    before, share = context.num_dynamic, context.training.recipe.dynamic_share
    shots = _shots_by_camera(context, generator)
    if before == gaussians.count or not shots:
        return
    capture = halved_capture(training.capture)

    def truth_of(index: int) -> torch.Tensor:
        camera = capture.cameras[capture.shots[index].camera]
        return image_on(gaussians.device, sized(training.store.image(index), camera))

    truths = {index: truth_of(index) for of_camera in shots for index in of_camera}
    error = temporal_error_std(context.gaussians_at, truths.__getitem__, capture, shots)[before:]
    brightness = float(np.mean([float(truth.mean()) for truth in truths.values()]))
    most = int(settings.max_unfrozen * len(error))
    if share:
        most = min(most, max(0, int(share * gaussians.count) - before))
    indices = error.topk(most).indices
    indices = indices[error[indices] > settings.unfreeze_error * brightness]

    @torch.no_grad()
    def apply(number: int) -> None:
        embedding = calmest_embedding(gaussians, training.deform(0.5)[1])
        gaussian_order.unfreeze_motion(gaussians, before + indices.sort().values, embedding)

    yield Proposal(
        StepKind.UNFREEZE,
        apply,
        lambda: gaussians.num_dynamic,
        forced=len(indices),
        work=lambda: context.gaussians_at(0.5),
    )


def _shots_by_camera(context: CompressionContext, generator: torch.Generator) -> list[list[int]]:
    """Shots of a few cameras, each at several times; of a moving camera some of all its frames."""
    capture, settings = context.training.capture, context.settings
    by_camera: dict[int, list[int]] = {}
    for index in context.record.learned:
        camera = 0 if capture.is_moving else capture.shots[index].camera
        by_camera.setdefault(camera, []).append(index)
    cameras = sorted(camera for camera, shots in by_camera.items() if len(shots) > 1)
    order = torch.randperm(len(cameras), generator=generator, device="cpu")[: settings.num_unfreeze_cameras]
    chosen = [by_camera[cameras[int(k)]] for k in order]
    return [[shots[int(k)] for k in np.linspace(0, len(shots) - 1, settings.num_unfreeze_times)] for shots in chosen]
