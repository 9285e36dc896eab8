"""Compression passes: prune, and freeze what the images show at rest.

A pass proposes something, or nothing. ``Compression.compress`` applies it only as far as the validation loss stays
within its tolerance, or as a budget requires, and logs what it saved.
"""

from dataclasses import replace

import numpy as np
import torch
from numpy.typing import NDArray

from ...capture.capture import Capture
from ...capture.seeding.views import spread
from ...frames.store import FrameStore
from ...scene.compression_report import StepKind
from ..optimize import gaussian_state
from ..optimize.gaussian_state import mask_excluding
from .context import Compression, Proposal
from .sensitivity import Sensitivity, in_state, peak_weights
from .validation import ValidationEvaluator

_CELL = 8  # pixels a side: a cell's mean is nearly free of noise, and of a film's compression
_COMPARED = 12, 240  # images: of each camera, and of all together, at least, as far as there are as many
_LEAST_CHANGE = 3 / 255
_NOISE_FACTOR = 2.0  # times what the typical cell changes by, where that is noise


def is_static_capture(capture: Capture, store: FrameStore) -> bool:
    """True when no part of the training images changes over time, or all show one moment; False where that cannot be
    told, because no camera stands still."""
    if len({shot.frame for shot in capture.train_shots}) == 1:
        return True
    by_camera = _compared(capture)
    return bool(by_camera) and not any(_changes(store, shots) for shots in by_camera.values())


def _compared(capture: Capture) -> dict[int, list[int]]:
    """Training shots of each camera that has several, over the whole film. Those of one camera lie between those of
    another. None where cameras move."""
    of_each, of_all = _COMPARED
    by_camera: dict[int, list[int]] = {}
    for index in capture.train_indices:
        by_camera.setdefault(capture.shots[index].camera, []).append(index)
    several = {camera: shots for camera, shots in sorted(by_camera.items()) if len(shots) > 1}
    compared = {}
    for rank, (camera, shots) in enumerate(several.items()):
        count, shift = min(max(of_each, of_all // len(several)), len(shots)), rank / len(several)
        places = {min(int((k + shift) * len(shots) / count), len(shots) - 1) for k in range(count)}
        compared[camera] = [shots[position] for position in sorted(places)]
    return compared


def _changes(store: FrameStore, shots: list[int]) -> bool:
    """Whether a camera's images change."""
    least = greatest = _cells(store.image(shots[0]))
    for index in shots[1:]:
        cells = _cells(store.image(index))
        least, greatest = np.minimum(least, cells), np.maximum(greatest, cells)
    spread = greatest - least
    typical = float(np.median(spread))  # noise, unless most of the image moves
    return typical > _LEAST_CHANGE or bool(spread.max() > max(_LEAST_CHANGE, _NOISE_FACTOR * typical))


def _cells(image: NDArray[np.uint8]) -> NDArray[np.float32]:
    """(rows, columns, 3) means in [0, 1] of whole cells of (H, W, 3) in [0, 255]; an image smaller than one is one."""
    import cv2

    height, width = image.shape[:2]
    size = max(1, width // _CELL), max(1, height // _CELL)
    return np.asarray(cv2.resize(image.astype(np.float32) / 255, size, interpolation=cv2.INTER_AREA))


def prune(context: Compression, evaluator: ValidationEvaluator, measured: Sensitivity) -> Proposal:
    """Gaussians that images do not need, or that the limit has no room for.

    What no image may miss is ordered by the image that would miss it most; where a budget forces, by what all of them
    together would.
    """
    training, gaussians, settings = context.training, context.training.gaussians, context.settings
    count, recipe = gaussians.count, training.recipe
    forced = count - recipe.kept_at_most
    order = (measured.energy if forced > 0 and recipe.kept_gaussians else measured.contribution).argsort()
    expected = evaluator.expected(measured.energy[order[: int(settings.max_pruned * count)]])
    return _pruning(context, evaluator, order, settings.max_prune_loss, expected, forced)


def prune_unmissed(context: Compression, evaluator: ValidationEvaluator, measured: Sensitivity) -> Proposal | None:
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
    if not 0 < len(order) < gaussians.count:
        return None
    expected = evaluator.expected(measured.energy[order])
    return _pruning(context, evaluator, order, settings.max_unmissed_loss, expected)


def _pruning(
    context: Compression,
    evaluator: ValidationEvaluator,
    order: torch.Tensor,
    allowed: float,
    expected: NDArray[np.float64],
    forced: int = 0,
) -> Proposal:
    """Removing the first of ``order``."""
    gaussians = context.training.gaussians
    count = gaussians.count

    def loss(taken: int) -> float:
        there = mask_excluding(order[:taken], count)
        return evaluator.loss(lambda drawn: replace(drawn, opacities=drawn.opacities * there))

    def apply(taken: int) -> None:
        keep = mask_excluding(order[:taken], count)
        gaussians.keep(keep.nonzero().squeeze(1))

    return Proposal(StepKind.PRUNE, apply, loss, allowed, expected, forced)


def freeze_motion(context: Compression, evaluator: ValidationEvaluator, allowed: float) -> Proposal | None:
    """Dynamic Gaussians whose motion images miss least, in their mean state: for ``allowed`` dB at most, and none whose
    motion can be seen but for what ``dynamic_share`` forces."""
    motion, gaussians, settings = context.motion, context.training.gaussians, context.settings
    before = context.num_dynamic
    if not before or motion is None:
        return None
    all_may = float(motion.score.max()) < settings.freeze_all_score
    may = motion.score < (settings.freeze_all_score if all_may else settings.freeze_score)
    by_energy = motion.rest_energy.argsort()
    order = torch.cat([by_energy[may[by_energy]], by_energy[~may[by_energy]]])
    share = context.training.recipe.dynamic_share
    expected = evaluator.expected(motion.rest_energy[order[: int(may.sum())]])
    forced = before - int(share * gaussians.count) if share else 0
    state = context.mean_state
    drawn = {
        "means": state["means"],
        "quaternions": state["quaternions"],
        "scales": state["log_scales"].exp(),
        "opacities": state["opacity_logits"].sigmoid(),
        "sh": state["sh"][:, : gaussians.canonical.sh.shape[1]],
    }

    def loss(taken: int) -> float:
        chosen = ~mask_excluding(order[:taken], before)
        return evaluator.loss(lambda all_: in_state(all_, chosen, drawn))

    def apply(taken: int) -> None:
        gaussian_state.freeze_motion(gaussians, order[:taken].sort().values, state)

    return Proposal(StepKind.FREEZE, apply, loss, allowed, expected, forced)
