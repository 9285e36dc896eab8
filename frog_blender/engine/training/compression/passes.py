"""Compression passes: prune, and freeze what the images show at rest.

A pass proposes something, or nothing. ``Compression.compress`` applies it only as far as the validation loss stays
within its tolerance, or as a budget requires, and logs what it saved.

Static image regions of static cameras are found by the temporal variance of 8x8 cells.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
import torch
from numpy.typing import NDArray

from ...capture.camera import Camera
from ...capture.capture import Capture
from ...capture.seeding.views import spread
from ...frames.store import FrameStore
from ...gaussians import TorchGaussians
from ...rasterizer import rasterize
from ...scene.compression_report import StepKind
from ...spherical_harmonics import SH_DC
from ..optimize import gaussian_state
from ..optimize.gaussian_state import mask_excluding
from ..optimize.stateful import Tensors
from .context import Compression, Proposal
from .sensitivity import SampledView, Sensitivity, in_state, peak_weights
from .validation import ValidationEvaluator

_CELL = 8  # pixels a side: a cell's mean is nearly free of noise, and of a film's compression
_COMPARED = 12, 240  # images: of each camera, and of all together, at least
_LEAST_CHANGE = 3 / 255
NOISE_FACTOR = 2.0  # times what the typical cell changes by, where that is noise
_MEASURED = 16, 240  # images that variance is measured on: of each camera, and of all together, at least
_SAMPLED = 2  # every second pixel a side is enough
QUIET_QUANTILE = 0.25  # of the cells have no more noise than all have


def is_static_capture(capture: Capture, store: FrameStore) -> bool:
    """True when no part of the training images changes over time, or all show one moment; False where that cannot be
    told, because no camera stands still."""
    if len({shot.frame for shot in capture.train_shots}) == 1:
        return True
    by_camera = _spread(capture, *_COMPARED)
    return bool(by_camera) and not any(_changes(store, shots) for shots in by_camera.values())


def temporal_variance(capture: Capture, store: FrameStore) -> dict[int, NDArray[np.float32]]:
    """How much the training images of each static camera change over time; empty where none has several.

    Returns:
        (rows, columns) float32 by camera, of the display range squared: of cells' means over time, or, where that is
        more, the mean over a cell of its pixels', less the noise of the whole image. The first finds uniform surfaces,
        the second what is finer than a cell.
    """
    return {camera: _variance(store, shots) for camera, shots in _spread(capture, *_MEASURED).items()}


def change_of_pixels(
    gaussians_at: Callable[[float], TorchGaussians],
    capture: Capture,
    views: Sequence[SampledView],
    variance: dict[int, NDArray[np.float32]],
) -> torch.Tensor:
    """(N,) the mean temporal variance of the pixels that each Gaussian colours in ``views``, weighted by blending
    weight; infinite where it colours none.
    """
    import cv2

    sums = torch.zeros((), device="cpu")
    for view in views:
        camera, gaussians = capture.cameras[view.camera], gaussians_at(view.time)
        cells, size = variance[view.camera], (camera.width, camera.height)
        of_pixels = np.asarray(cv2.resize(cells, size, interpolation=cv2.INTER_NEAREST))
        sums = sums + sums_of_pixels(gaussians, camera, of_pixels, capture.background)
    return torch.where(sums[:, 1] >= 1, sums[:, 0] / sums[:, 1], torch.inf)


def sums_of_pixels(
    gaussians: TorchGaussians, camera: Camera, of_pixels: NDArray[np.float32], background: tuple[float, float, float]
) -> torch.Tensor:
    """(N, 3) the sum over a camera's pixels of numbers (H, W), each times the Gaussian's blending weight there; the sum
    of the weights; and zeros.

    A Gaussian's red is in the image's red by its blending weights: the backward pass sums what it is given in their
    proportion. It is given the numbers in red and ones in green, which counts the weights.
    """
    grey = torch.zeros_like(gaussians.sh[:, :1]).requires_grad_()  # no colour is clamped
    image = rasterize(replace(gaussians, sh=grey), camera, background).rgb
    given = torch.from_numpy(of_pixels).to(image.device)
    image.backward(torch.stack([given, torch.ones_like(given), torch.zeros_like(given)], dim=2))
    assert grey.grad is not None
    return grey.grad[:, 0] / SH_DC


def _variance(store: FrameStore, shots: list[int]) -> NDArray[np.float32]:
    """(rows, columns) of ``temporal_variance``."""
    images = [store.image(index)[::_SAMPLED, ::_SAMPLED] for index in shots]
    cell = _CELL // _SAMPLED
    total, squares = (np.zeros(images[0].shape, np.int64) for _ in range(2))
    for image in images:
        total += image
        squares += image.astype(np.uint16) ** 2
    of_each = (squares - total**2 / len(shots)) / len(shots)
    of_pixels = _cells(of_each / 255, cell).mean(2)
    of_means = np.var([_cells(image, cell) for image in images], axis=0).mean(2)
    noise = NOISE_FACTOR * float(np.quantile(of_pixels, QUIET_QUANTILE))
    variance = np.maximum(np.maximum(of_means - noise / cell**2, of_pixels - noise), 0)
    return np.asarray(variance, dtype=np.float32)


def _spread(capture: Capture, least: int, most: int) -> dict[int, list[int]]:
    """Training shots of each camera that has several, over the whole film: ``least`` of each and ``most`` of all
    together, at least, as far as there are as many. Those of one camera lie between those of another. None where
    cameras move."""
    by_camera: dict[int, list[int]] = {}
    for index in capture.train_indices:
        by_camera.setdefault(capture.shots[index].camera, []).append(index)
    several = {camera: shots for camera, shots in sorted(by_camera.items()) if len(shots) > 1}
    spread = {}
    for rank, (camera, shots) in enumerate(several.items()):
        count, shift = min(max(least, most // len(several)), len(shots)), rank / len(several)
        places = {min(int((k + shift) * len(shots) / count), len(shots) - 1) for k in range(count)}
        spread[camera] = [shots[position] for position in sorted(places)]
    return spread


def _changes(store: FrameStore, shots: list[int]) -> bool:
    """Whether a camera's images change."""
    least = greatest = _cells(store.image(shots[0]))
    for index in shots[1:]:
        cells = _cells(store.image(index))
        least, greatest = np.minimum(least, cells), np.maximum(greatest, cells)
    spread = greatest - least
    typical = float(np.median(spread))  # noise, unless most of the image moves
    return typical > _LEAST_CHANGE or bool(spread.max() > max(_LEAST_CHANGE, NOISE_FACTOR * typical))


def _cells(pixels: NDArray[np.float32 | np.uint8], cell: int = _CELL) -> NDArray[np.float32]:
    """(rows, columns, 3) means in [0, 1] of whole cells of (H, W, 3) in [0, 255]; an image smaller than one is one."""
    import cv2

    height, width = pixels.shape[:2]
    size = max(1, width // cell), max(1, height // cell)
    return np.asarray(cv2.resize(pixels.astype(np.float32) / 255, size, interpolation=cv2.INTER_AREA))


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
        removed = gaussians.canonical.means.detach()[~keep].cpu().numpy()
        context.removed = np.concatenate([context.removed, removed])
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
    apply, loss = _freezing(context, evaluator, order, context.mean_state)
    return Proposal(StepKind.FREEZE, apply, loss, allowed, expected, forced)


def freeze_static_regions(
    context: Compression, evaluator: ValidationEvaluator, generator: torch.Generator
) -> Proposal | None:
    """Dynamic Gaussians where the images hardly change, while motion is still being learned: all of them or none. Few
    are not worth disturbing a training that still finds its motion."""
    training, settings, before = context.training, context.settings, context.num_dynamic
    variance = temporal_variance(training.capture, training.store) if before else {}
    views = [view for view in context.sample_views(generator) if view.camera in variance]
    if not views:
        return None
    change = change_of_pixels(context.gaussians_at, training.capture, views, variance)[:before]
    static = (change < settings.static_deviation**2).nonzero().squeeze(1)
    if len(static) <= settings.min_frozen * before:
        return None
    apply, loss = _freezing(context, evaluator, static, context.mean_dynamic_state(views))
    return Proposal(StepKind.FREEZE, apply, loss, settings.max_freeze_loss, np.zeros(len(static)))


def _freezing(
    context: Compression, evaluator: ValidationEvaluator, order: torch.Tensor, state: Tensors
) -> tuple[Callable[[int], None], Callable[[int], float]]:
    """Freezes the first so many of ``order``, dynamic Gaussians, in ``state`` (of all dynamic ones); and what that
    costs."""
    gaussians = context.training.gaussians
    before = gaussians.num_dynamic
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

    return apply, loss
