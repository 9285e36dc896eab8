"""A finished scene as its file plays it: Gaussians in the order that packs and plays best, and what that saves."""

from __future__ import annotations

import statistics
import time
from collections.abc import Iterator
from typing import TYPE_CHECKING

import numpy as np
import torch

from ..files import SceneFile
from ..inference.deformation import PlayableDeformation
from ..inference.lifetimes import lifetimes, of_groups, share_deformed, together
from ..inference.scene import BY_GAUSSIAN, PlayableScene
from ..packing import pack, unpack
from ..rasterizer import GaussianArrays
from ..spatial_order import neighbours_together
from .parsimony import Parsimony, Reduction

if TYPE_CHECKING:
    from .trainer import Trainer

_WORTH_IT = 0.9  # of the groups that move: where more are deformed at a moment, lifetimes save nothing to speak of
_TIMED = 9  # moments


def arranged(scene: SceneFile) -> SceneFile:
    """Neighbours together; and of those that move those that live at the same times, where that spares playback some of
    them, which the array ``lifetimes`` then says (see inference.lifetimes)."""
    arrays, header = scene.arrays, scene.header
    moving = len(arrays.get("embeddings", ()))
    arrays = _in_order(arrays, neighbours_together(arrays["means"], moving))
    if not moving or header.frame_count < 2 or header.method != "frog" or header.model["head_width"]:
        return SceneFile(header, arrays)
    field = PlayableDeformation(arrays, header.model)
    lives = lifetimes(lambda moment: field.at(moment).opacities[:moving], header.frame_count)
    order = together(lives)
    groups = of_groups(lives[:, order])
    if share_deformed(groups, moving) < _WORTH_IT:
        arrays = _in_order(arrays, np.concatenate([order, np.arange(moving, len(arrays["means"]))]))
        arrays["lifetimes"] = groups
    return SceneFile(header, arrays)


def as_packed(scene: SceneFile) -> SceneFile:
    """The scene with numbers as they come back from a packed file."""
    arrays = dict(scene.arrays)
    for name, array in scene.arrays.items():
        if array.dtype != np.uint8:
            packed = pack(name, array)
            arrays[name] = unpack(packed.content, packed.description)
    return SceneFile(scene.header, arrays)


def compactions(rounds: Parsimony, trainer: Trainer, scene: SceneFile, size: int) -> list[Reduction]:
    """What packing an ``arranged`` scene into ``size`` bytes, and its lifetimes, save and cost."""
    packed = as_packed(scene)
    without = {name: array for name, array in packed.arrays.items() if name != "lifetimes"}
    plain, found = sum(array.nbytes for array in scene.arrays.values()), []
    always = PlayableScene(SceneFile(scene.header, without))
    psnr = _psnr(rounds, trainer, always)
    loss = rounds.judge(trainer).now - psnr
    found.append(Reduction("packed", 1.0, plain, size, loss, bytes=plain - size))
    if "lifetimes" in packed.arrays:
        playable = PlayableScene(packed)
        loss = psnr - _psnr(rounds, trainer, playable)
        deformed = round(playable.moving * share_deformed(packed.arrays["lifetimes"], playable.moving))
        saved = _milliseconds(always) - _milliseconds(playable)
        found.append(Reduction("unseen left out", 1.0, playable.moving, deformed, loss, saved))
    return found


def _in_order(arrays: dict[str, np.ndarray], order: np.ndarray) -> dict[str, np.ndarray]:
    """Those of each Gaussian in ``order``, of which the movers are the first."""
    return {n: array[order[: len(array)]] if n in BY_GAUSSIAN else array for n, array in arrays.items()}


def _psnr(rounds: Parsimony, trainer: Trainer, scene: PlayableScene) -> float:
    """Of the scene as it is played, on the withheld pictures."""

    def gaussians_at(moment: float) -> GaussianArrays:
        arrays = vars(scene.at(moment)).values()
        return GaussianArrays(*(torch.from_numpy(np.array(array)).to(trainer.device) for array in arrays))

    return rounds.judge(trainer, played=gaussians_at).now


def _milliseconds(scene: PlayableScene) -> float:
    """The median of a frame's deformation."""
    return 1e3 * statistics.median(_seconds(scene))


def _seconds(scene: PlayableScene) -> Iterator[float]:
    for moment in np.linspace(0, 1, _TIMED):
        started = time.perf_counter()
        scene.part_at(moment)
        yield time.perf_counter() - started
