"""A finished scene as its file plays it: Gaussians in the order that packs and plays best, and what that saves."""

from __future__ import annotations

import statistics
import time
from typing import TYPE_CHECKING

import numpy as np
import torch

from ..files import LIFETIMES, SceneFile, packed_arrays
from ..inference.deformation import PlayableDeformation
from ..inference.lifetimes import lifetimes, of_groups, share_deformed, together
from ..inference.scene import BY_GAUSSIAN, PlayableScene
from ..packing import unpack
from ..rasterizer import GaussianArrays
from ..spatial_order import neighbours_together
from .parsimony import Parsimony, Reduction

if TYPE_CHECKING:
    from .trainer import Trainer

_WORTH_IT = 0.9  # of the groups that move: where more are deformed at a moment, lifetimes save nothing to speak of
_TIMED = 15  # moments


def arranged(scene: SceneFile, finished: bool = True) -> SceneFile:
    """Neighbours together; and when training is ``finished``, of those that move, those that live at the same times,
    where that spares playback some of them, which the array ``lifetimes`` then says (see inference.lifetimes)."""
    header, moving = scene.header, len(scene.arrays.get("embeddings", ()))
    near = _in_order(scene, neighbours_together(scene.arrays["means"], moving))
    in_groups = moving and header.method == "frog" and not header.model["head_width"]
    if not finished or not in_groups or header.frame_count < 2:
        return near
    lives = _lives(near)
    order = together(lives)
    if share_deformed(of_groups(lives[:, order]), moving) > _WORTH_IT:
        return near
    rest = np.arange(moving, len(scene.arrays["means"]))
    found = _in_order(near, np.concatenate([order, rest]))
    lives = lives[:, order] | _lives(as_packed(found))  # whose opacities are others, by a little
    return SceneFile(header, found.arrays | {LIFETIMES: of_groups(lives)})


def as_packed(scene: SceneFile) -> SceneFile:
    """The scene with numbers as they come back from a packed file; FrogError where none can hold them."""
    packed = packed_arrays(scene.arrays)
    return SceneFile(scene.header, {name: unpack(each.content, each.description) for name, each in packed.items()})


def compactions(rounds: Parsimony, trainer: Trainer, scene: SceneFile, size: int) -> tuple[Reduction, Reduction | None]:
    """What packing an ``arranged`` scene into ``size`` bytes saves and costs, and what its lifetimes do, if any."""
    packed = as_packed(scene)
    playable = PlayableScene(packed)
    always = PlayableScene(SceneFile(packed.header, {k: v for k, v in packed.arrays.items() if k != LIFETIMES}))
    plain, psnr = sum(array.nbytes for array in scene.arrays.values()), _psnr(rounds, trainer, always)
    loss = rounds.judge(trainer).now - psnr
    packing = Reduction("packed", 1.0, plain, size, loss, bytes=plain - size)
    if LIFETIMES not in packed.arrays:
        return packing, None
    deformed = round(playable.moving * share_deformed(packed.arrays[LIFETIMES], playable.moving))
    loss, saved = psnr - _psnr(rounds, trainer, playable), _milliseconds_between(always, playable)
    return packing, Reduction("unseen left out", 1.0, playable.moving, deformed, loss, saved)


def _lives(scene: SceneFile) -> np.ndarray:
    """(frames - 1, M) see inference.lifetimes."""
    field = PlayableDeformation(scene.arrays, scene.header.model)
    return lifetimes(lambda moment: field.at(moment).opacities[: field.moving], scene.header.frame_count)


def _in_order(scene: SceneFile, order: np.ndarray) -> SceneFile:
    """Its Gaussians in ``order``, of which the movers are the first."""
    arrays = {n: array[order[: len(array)]] if n in BY_GAUSSIAN else array for n, array in scene.arrays.items()}
    return SceneFile(scene.header, arrays)


def _psnr(rounds: Parsimony, trainer: Trainer, scene: PlayableScene) -> float:
    """Of the scene as it is played, on the withheld pictures."""

    def gaussians_at(moment: float) -> GaussianArrays:
        arrays = vars(scene.at(moment)).values()
        return GaussianArrays(*(torch.from_numpy(np.array(array)).to(trainer.device) for array in arrays))

    return rounds.judge(trainer, played=gaussians_at).now


def _milliseconds_between(slow: PlayableScene, fast: PlayableScene) -> float:
    """By which a frame of the one takes longer, in the median of some moments at which they take turns."""
    longer = []
    for moment in np.linspace(0, 1, _TIMED):
        started = time.perf_counter()
        slow.at(moment)
        between = time.perf_counter()
        fast.at(moment)
        longer.append(2 * between - started - time.perf_counter())
    return 1e3 * statistics.median(longer)
