"""A finished scene as its file plays it: Gaussians in the order that packs and plays best, and what that saves."""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np
import torch

from ...playback.deformation import DeformationPlayer
from ...playback.player import ScenePlayer, row_ranges
from ...playback.visibility import mean_deformed_share, pack_group_bits, sort_by_visibility, visible_intervals
from ...rasterizer import GaussianArrays
from ...scene.header import SHAPE_DYNAMIC
from ...scene.morton_order import morton_order_by_range
from ...scene.quantization import unpack
from ...scene.scene_file import OPACITY_TRACKS, VISIBILITY, SceneFile, packed_arrays
from .schedule import CompressionSchedule, CompressionStep

if TYPE_CHECKING:
    from ..optimize.trainer import Trainer

_WORTH_IT = 0.9  # of the groups that move: where more are deformed at a moment, lifetimes save nothing to speak of
_TIMED = 15  # moments


def arranged(scene: SceneFile, finished: bool = True) -> SceneFile:
    """Neighbours together, each kind of Gaussians in its place; and when training is ``finished``, of those that are
    deformed, those that live at the same times, where that spares playback some of them, which the array ``lifetimes``
    then says (see inference.lifetimes)."""
    deformed, fading = len(scene.arrays.get("embeddings", ())), len(scene.arrays.get(OPACITY_TRACKS, ()))
    num_shape_dynamic = scene.header.model.get(SHAPE_DYNAMIC, deformed)
    near = in_order(scene, morton_order_by_range(scene.arrays["means"], num_shape_dynamic, deformed, deformed + fading))
    if not finished or not has_transients(near):
        return near
    lives = _lives(near)
    order = np.concatenate(
        [
            sort_by_visibility(lives[:, :num_shape_dynamic]),
            num_shape_dynamic + sort_by_visibility(lives[:, num_shape_dynamic:]),
        ]
    )
    found = in_order(near, np.concatenate([order, np.arange(deformed, len(near.arrays["means"]))]))
    lives = lives[:, order] | _lives(as_packed(found))  # whose opacities are others, by a little
    return SceneFile(scene.header, found.arrays | {VISIBILITY: pack_group_bits(lives)})


def in_groups(scene: SceneFile) -> bool:
    """Whether playback deforms Gaussians of the scene in groups (see inference.groups), and it is FRoG's."""
    header = scene.header
    return bool(len(scene.arrays.get("embeddings", ())) and header.method == "frog" and not header.model["head_width"])


def has_transients(scene: SceneFile) -> bool:
    """Whether playback needs to deform clearly fewer Gaussians at a moment than there are, together as they live."""
    if not in_groups(scene) or scene.header.frame_count < 2:
        return False
    lives = _lives(scene)
    return mean_deformed_share(pack_group_bits(lives[:, sort_by_visibility(lives)]), lives.shape[1]) <= _WORTH_IT


def as_packed(scene: SceneFile) -> SceneFile:
    """The scene with numbers as they come back from a packed file; FrogError where none can hold them."""
    packed = packed_arrays(scene.arrays)
    return SceneFile(scene.header, {name: unpack(each.content, each.description) for name, each in packed.items()})


def compactions(
    rounds: CompressionSchedule, trainer: Trainer, scene: SceneFile, size: int, lost: float
) -> tuple[CompressionStep, CompressionStep | None]:
    """What packing an ``arranged`` scene into ``size`` bytes saves and costs, and what its lifetimes do, if any.

    Args:
        lost: dB that the scene itself is below the model.
    """
    packed = as_packed(scene)
    playable = ScenePlayer(packed)
    always = ScenePlayer(SceneFile(packed.header, {k: v for k, v in packed.arrays.items() if k != VISIBILITY}))
    plain, psnr = sum(array.nbytes for array in scene.arrays.values()), _psnr(rounds, trainer, always)
    loss = rounds.judge(trainer).now - lost - psnr
    packing = CompressionStep("packed", 1.0, plain, size, loss, bytes=plain - size)
    if VISIBILITY not in packed.arrays:
        return packing, None
    count = len(packed.arrays["embeddings"])
    deformed = round(count * mean_deformed_share(packed.arrays[VISIBILITY], count))
    loss, saved = psnr - _psnr(rounds, trainer, playable), milliseconds_between(always, playable)
    return packing, CompressionStep("unseen left out", 1.0, count, deformed, loss, saved)


def _lives(scene: SceneFile) -> np.ndarray:
    """(frames - 1, M) of those that are deformed, see inference.lifetimes."""
    field = DeformationPlayer(scene.arrays, scene.header.model)
    return visible_intervals(lambda moment: field.at(moment).opacities[: field.deformed], scene.header.frame_count)


def in_order(scene: SceneFile, order: np.ndarray) -> SceneFile:
    """Its Gaussians in ``order``, in which each kind of them (see inference.scene.rows_of) stays in its place."""
    rows = row_ranges(scene.arrays)
    arrays = {n: array[order[rows[n]] - rows[n].start] if n in rows else array for n, array in scene.arrays.items()}
    return SceneFile(scene.header, arrays)


def played_by(scene: ScenePlayer, device: torch.device) -> Callable[[float], GaussianArrays]:
    """Its Gaussians at a time in [0, 1], for torch."""

    def gaussians_at(moment: float) -> GaussianArrays:
        arrays = vars(scene.at(moment)).values()
        return GaussianArrays(*(torch.from_numpy(np.array(array)).to(device) for array in arrays))

    return gaussians_at


def _psnr(rounds: CompressionSchedule, trainer: Trainer, scene: ScenePlayer) -> float:
    """Of the scene as it is played, on the withheld images."""
    return rounds.judge(trainer, played=played_by(scene, trainer.device)).now


def milliseconds_between(slow: ScenePlayer, fast: ScenePlayer) -> float:
    """By which a frame of the one takes longer, in the median of some moments at which they take turns."""
    longer = []
    for moment in np.linspace(0, 1, _TIMED):
        started = time.perf_counter()
        slow.at(moment)
        between = time.perf_counter()
        fast.at(moment)
        longer.append(2 * between - started - time.perf_counter())
    return 1e3 * statistics.median(longer)
