"""What a round can do to a model: leave Gaussians out, cut colours, put to rest, wake, silence heads.

What takes away is proposed to the round's judge first (but for what budgets force), does what is allowed,
and notes what that saved.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
import torch

from ...model.frog import Frog
from ...rasterizer import GaussianArrays
from ..optimize.device import image_on
from ..optimize.gaussian_order import arrange, freeze_motion, gaussians_at, mask_excluding, mean_dynamic_state, wake
from ..optimize.half_resolution import halved_capture, sized
from .sensitivity import Motion, Sensitivity
from .static_regions import measure_temporal_variance
from .temporal_residual import change, temporal_error_std
from .validation import ValidationEvaluator, largest_count_within

if TYPE_CHECKING:
    from ..optimize.trainer import Trainer
    from .schedule import CompressionSchedule

ALLOWED_LOSS, ALLOWED_LOSS_AT_END = 0.05, 0.02
"""dB that putting Gaussians to rest may cost on the withheld images, where steps make it up and where none does."""
ALLOWED_PRUNING_LOSS, ALLOWED_COLOR_LOSS, ALLOWED_HEAD_LOSS = 0.03, 0.03, 0.01
RESTS_BELOW, ALL_REST_BELOW = 4.0, 2.0
"""Score (see motion.Motion) below which a Gaussian may rest; and below which every one may, if none is above."""
_UNCHANGED, _LEAST_CHANGE = 0.002, 2 / 255  # of the images' squared error; standard deviation that may be seen
_WORTH_IT = 0.25  # of those that move: where fewer may rest early, that saves no time, and dim lost 0.24 dB by it
_MOSTLY_STILL = 0.5  # of the images: Gaussians are fewer where nothing moves, so with less it cannot be worth it
_GLANCE, _CLEARLY = 2, 5.0  # images that tell at once what costs clearly more than is allowed: so many times
_MOST_PRUNED = 0.6  # of the Gaussians, in a round
_WAKES_ABOVE = 0.1  # error that changes with time, of the images' mean brightness
_MOST_WOKEN = 0.1  # of the Gaussians at rest
_WAKING_CAMERAS, _WAKING_MOMENTS = 3, 8


def prune(
    rounds: CompressionSchedule, trainer: Trainer, judge: ValidationEvaluator, measured: Sensitivity
) -> Sensitivity:
    """Leaves out Gaussians that images do not need, or that the limit has no room for; returns what was measured of
    those that stay.

    What no image may miss is judged by the image that would miss it most; where a budget forces, by what all of
    them together would.
    """
    count, canonical = trainer.count, trainer.model.canonical
    forced = count - trainer.recipe.kept_at_most
    order = (measured.energy if forced > 0 and trainer.recipe.kept_gaussians else measured.contribution).argsort()

    def without(number: int) -> float:
        there = mask_excluding(order[:number], count)
        return judge.loss(lambda gaussians: replace(gaussians, opacities=gaussians.opacities * there))

    expected = judge.expected(measured.energy[order[: int(_MOST_PRUNED * count)]])
    number, loss = largest_count_within(without, expected, ALLOWED_PRUNING_LOSS)
    if forced > number:
        number, loss = forced, without(forced)
    if not number:
        return measured
    keep = mask_excluding(order[:number], count)
    rounds.removed = np.concatenate([rounds.removed, canonical.means.detach()[~keep].cpu().numpy()])
    kept = keep.nonzero().squeeze(1)
    movers = kept[kept < canonical.num_dynamic]
    with rounds.noted("pruned", trainer, lambda: trainer.count, lambda: trainer.render_image(rounds.judged[0]), loss):
        arrange(trainer, kept, movers)
    judge.accept(loss)
    state = {name: values[movers] for name, values in measured.state.items()}
    return Sensitivity(measured.motion.of(movers), measured.contribution[kept], measured.energy[kept], state)


def reduce_sh_degree(rounds: CompressionSchedule, trainer: Trainer, judge: ValidationEvaluator) -> None:
    """Takes the highest degrees of spherical harmonics away that the withheld images do not miss, all together."""
    canonical, lost = trainer.model.canonical, 0.0

    def degree() -> int:
        return math.isqrt(canonical.sh.shape[1]) - 1

    while (left := degree() ** 2) and left >= trainer.recipe.deformed_sh:

        def cut(gaussians: GaussianArrays, left: int = left) -> GaussianArrays:
            return replace(gaussians, sh=gaussians.sh[:, :left].contiguous())

        if lost + (loss := judge.loss(cut)) > ALLOWED_COLOR_LOSS:
            break
        with rounds.noted("SH degree", trainer, degree, lambda: trainer.render_image(rounds.judged[0]), loss):
            trainer.optimizer.reduce_sh_degree(left)
        judge.accept(loss)
        lost += loss


def silence_heads(rounds: CompressionSchedule, trainer: Trainer, judge: ValidationEvaluator) -> None:
    """Sets heads of the network to zero, for good, whose output the withheld images do not miss.

    Zeros take no room in a packed file, and where heads have layers of their own (the papers' networks) a silent head's
    is not computed; elsewhere the outputs of all heads are one matrix product of whole vectors.
    """
    model = trainer.model
    if not isinstance(model, Frog) or not model.canonical.num_dynamic:
        return
    glance = rounds.judge(trainer, _GLANCE)
    for name in model.heads:
        rows = model.output_rows(name)

        def silent(key: str, value: torch.Tensor, rows: slice = rows) -> torch.Tensor:
            if key.startswith("deformation.output"):
                value = value.clone()
                value[rows] = 0
            return value

        if glance.now - rounds.psnr_with(trainer, silent, _GLANCE) > _CLEARLY * ALLOWED_HEAD_LOSS:
            continue
        loss = judge.now - rounds.psnr_with(trainer, silent)
        if loss > ALLOWED_HEAD_LOSS:
            continue
        before = len(model.heads)
        model.prune_head(name)
        for parameter in (model.deformation.output_weight, model.deformation.output_bias):
            trainer.optimizer.stop(parameter, rows)
        rounds.note(f"head {name}", trainer, before, len(model.heads), loss)
        judge.accept(loss)


def rest(
    rounds: CompressionSchedule,
    trainer: Trainer,
    judge: ValidationEvaluator,
    motion: Motion,
    state: dict[str, torch.Tensor],
    allowed: float = ALLOWED_LOSS,
) -> None:
    """Puts Gaussians to rest, in their mean ``state`` (see motion.Measured), whose motion images miss least: for
    ``allowed`` dB at most, and none whose motion anybody would see but for what ``dynamic_share`` forces."""
    canonical = trainer.model.canonical
    if not canonical.num_dynamic:
        return
    may = motion.score < (ALL_REST_BELOW if float(motion.score.max()) < ALL_REST_BELOW else RESTS_BELOW)
    candidates = int(may.sum())
    by_energy = motion.rest_energy.argsort()
    order = torch.cat([by_energy[may[by_energy]], by_energy[~may[by_energy]]])

    def at_rest(number: int) -> float:
        return _loss_at_rest(trainer, judge, order[:number], state)

    number, loss = largest_count_within(at_rest, judge.expected(motion.rest_energy[order[:candidates]]), allowed)
    share = trainer.recipe.dynamic_share
    forced = canonical.num_dynamic - int(share * trainer.count) if share else 0
    if forced > number:
        number, loss = forced, at_rest(forced)
    if not number:
        return
    with rounds.noted("put to rest", trainer, lambda: canonical.num_dynamic, lambda: gaussians_at(trainer, 0.5), loss):
        freeze_motion(trainer, order[:number].sort().values, state)
    judge.accept(loss)


def freeze_static_regions(rounds: CompressionSchedule, trainer: Trainer, generator: torch.Generator) -> None:
    """Puts to rest, while motion is still being learned, what lies where the images hardly change: those whose pixels
    change least, none that anybody would see, as many as cost no more than a small part of the images' error now. Few
    are not worth the change of a training that is still finding its motion."""
    canonical = trainer.model.canonical
    changes = measure_temporal_variance(trainer.capture, trainer.store) if canonical.num_dynamic else None
    if not changes or changes.still(_LEAST_CHANGE) < _MOSTLY_STILL:
        return
    looks = [look for look in rounds.sample_views(generator) if look.camera in changes.variance]
    if not looks:
        return
    judge = rounds.judge(trainer)
    cameras = [trainer.capture.cameras[look.camera] for look in looks]
    allowed = _UNCHANGED * 10 ** (-judge.now / 10) * sum(camera.width * camera.height for camera in cameras)
    found = change(lambda moment: gaussians_at(trainer, moment), trainer.capture, looks, changes)
    pixels, lost = (values[: canonical.num_dynamic] for values in found)
    each = torch.where(pixels >= 1, lost / pixels, torch.inf)
    order = each.argsort()
    number = int(((lost[order].cumsum(0) <= allowed) & (each[order] < _LEAST_CHANGE**2)).sum())
    if number < max(1, _WORTH_IT * canonical.num_dynamic):
        return
    state = mean_dynamic_state(trainer, looks)
    loss = _loss_at_rest(trainer, judge, order[:number], state)
    if loss > ALLOWED_LOSS:
        return
    with rounds.noted("put to rest", trainer, lambda: canonical.num_dynamic, lambda: gaussians_at(trainer, 0.5), loss):
        freeze_motion(trainer, order[:number].sort().values, state)


def _loss_at_rest(
    trainer: Trainer, judge: ValidationEvaluator, who: torch.Tensor, state: dict[str, torch.Tensor]
) -> float:
    """dB that it costs when Gaussians that move, ``who``, are as in ``state`` (of all that move)."""
    canonical = trainer.model.canonical
    moves = mask_excluding(who, canonical.num_dynamic)
    drawn = {
        **state,
        "scales": state["log_scales"].exp(),
        "opacities": state["opacity_logits"].sigmoid(),
        "sh": state["sh"][:, : canonical.sh.shape[1]],
    }

    def at_rest(name: str, value: torch.Tensor) -> torch.Tensor:
        of_movers = moves.view(-1, *[1] * (value.dim() - 1))
        return torch.cat([torch.where(of_movers, value[: len(moves)], drawn[name]), value[len(moves) :]])

    return judge.loss(lambda gaussians: GaussianArrays(**{k: at_rest(k, v) for k, v in vars(gaussians).items()}))


def unfreeze_high_error(rounds: CompressionSchedule, trainer: Trainer, generator: torch.Generator) -> None:
    """Lets those move again around which the error changes with time; half the pixels a side show that."""
    canonical = trainer.model.canonical
    moving = canonical.num_dynamic
    shots = _moments_of_cameras(trainer, rounds.looked_at, generator)
    if moving == trainer.count or not shots:
        return
    capture = halved_capture(trainer.capture)

    def truth_of(index: int) -> torch.Tensor:
        camera = capture.cameras[capture.shots[index].camera]
        return image_on(trainer.device, sized(trainer.store.image(index), camera))

    truths = {index: truth_of(index) for of in shots for index in of}
    found = temporal_error_std(lambda moment: gaussians_at(trainer, moment), truths.__getitem__, capture, shots)[
        moving:
    ]
    brightness = float(np.mean([float(truth.mean()) for truth in truths.values()]))
    most = int(_MOST_WOKEN * len(found))
    if trainer.recipe.dynamic_share:
        most = min(most, max(0, int(trainer.recipe.dynamic_share * trainer.count) - moving))
    who = found.topk(most).indices
    who = who[found[who] > _WAKES_ABOVE * brightness]
    if not len(who):
        return
    with rounds.noted("woken", trainer, lambda: canonical.num_dynamic, lambda: gaussians_at(trainer, 0.5)):
        wake(trainer, moving + who.sort().values)


def _moments_of_cameras(trainer: Trainer, shots: list[int], generator: torch.Generator) -> list[list[int]]:
    """Shots of a few cameras, each at several moments; of a moving camera some of all its moments."""
    by_camera: dict[int, list[int]] = {}
    for index in shots:
        camera = 0 if trainer.capture.is_moving else trainer.capture.shots[index].camera
        by_camera.setdefault(camera, []).append(index)
    cameras = sorted(camera for camera, of in by_camera.items() if len(of) > 1)
    chosen = [
        cameras[int(k)] for k in torch.randperm(len(cameras), generator=generator, device="cpu")[:_WAKING_CAMERAS]
    ]
    return [
        [by_camera[camera][int(k)] for k in np.linspace(0, len(by_camera[camera]) - 1, _WAKING_MOMENTS)]
        for camera in chosen
    ]
