"""A finished scene as its file plays it: Gaussians in the order that packs and plays best, and what that saves."""

from __future__ import annotations

import numpy as np
import torch
from numpy.typing import NDArray

from ...gaussians import TorchGaussians
from ...playback.deformation import (
    DeformationPlayer,
    mean_deformed_share,
    pack_group_bits,
    sort_by_visibility,
    visible_intervals,
)
from ...playback.player import ScenePlayer, row_ranges
from ...rasterizer import GaussianArrays
from ...scene.compression_report import StepKind
from ...scene.quantization import morton_order_by_range, unpack
from ...scene.scene_file import VISIBILITY, SceneFile, packed_arrays
from .context import Compression, CompressionStep
from .settings import DEFAULT


def reorder_for_playback(
    scene: SceneFile, finished: bool = True, max_visible: float = DEFAULT.max_visible
) -> SceneFile:
    """The scene with neighbours together, each kind of Gaussians in its place.

    When training is ``finished``, dynamic Gaussians that are visible at the same times come together, where that spares
    playback some of them; the array ``lifetimes`` says when (see playback.deformation).
    """
    count, deformed = len(scene.arrays["means"]), len(scene.arrays.get("embeddings", ()))
    near = in_order(scene, morton_order_by_range(scene.arrays["means"], *({deformed} - {0, count})))
    if not finished or not has_transients(near, max_visible):
        return near
    lives = _lives(near)
    order = sort_by_visibility(lives)
    sorted_ = in_order(near, np.concatenate([order, np.arange(len(order), count)]))
    lives = lives[:, order] | _lives(as_packed(sorted_))  # whose opacities differ a little
    return SceneFile(scene.header, sorted_.arrays | {VISIBILITY: pack_group_bits(lives)})


def has_transients(scene: SceneFile, max_visible: float = DEFAULT.max_visible) -> bool:
    """Whether playback needs to deform clearly fewer Gaussians in a frame than there are: FRoG's, which it deforms in
    groups (see playback.deformation)."""
    header = scene.header
    if not len(scene.arrays.get("embeddings", ())) or header.method != "frog" or header.frame_count < 2:
        return False
    if header.model["head_width"]:
        return False
    lives = _lives(scene)
    return mean_deformed_share(pack_group_bits(lives[:, sort_by_visibility(lives)]), lives.shape[1]) <= max_visible


def as_packed(scene: SceneFile) -> SceneFile:
    """The scene with numbers as they come back from a packed file; FrogError where none can hold them."""
    packed = packed_arrays(scene.arrays)
    return SceneFile(scene.header, {name: unpack(array.content, array.description) for name, array in packed.items()})


def playback_steps(context: Compression, scene: SceneFile, size: int) -> tuple[CompressionStep, CompressionStep | None]:
    """What packing a reordered scene into ``size`` bytes saves and costs, and what its lifetimes do, if any."""
    packed = as_packed(scene)
    player = ScenePlayer(packed)
    always = ScenePlayer(SceneFile(packed.header, {k: v for k, v in packed.arrays.items() if k != VISIBILITY}))
    plain, psnr = sum(array.nbytes for array in scene.arrays.values()), _psnr(context, always)
    loss = context.evaluator().now - psnr
    packing = CompressionStep(StepKind.PACK, 1.0, plain, size, loss, bytes=plain - size)
    if VISIBILITY not in packed.arrays:
        return packing, None
    count = len(packed.arrays["embeddings"])
    deformed = round(count * mean_deformed_share(packed.arrays[VISIBILITY], count))
    loss = psnr - _psnr(context, player)
    return packing, CompressionStep(StepKind.VISIBILITY, 1.0, count, deformed, loss)


def _lives(scene: SceneFile) -> NDArray[np.bool_]:
    """(frames - 1, M) of the dynamic Gaussians, see playback.deformation."""
    field = DeformationPlayer(scene.arrays, scene.header.model)
    return visible_intervals(lambda time_: field.at(time_).opacities[: field.num_dynamic], scene.header.frame_count)


def in_order(scene: SceneFile, order: NDArray[np.int64]) -> SceneFile:
    """Its Gaussians in ``order``, in which deformed ones stay before static ones."""
    rows = row_ranges(scene.arrays)
    arrays = {n: array[order[rows[n]] - rows[n].start] if n in rows else array for n, array in scene.arrays.items()}
    return SceneFile(scene.header, arrays)


def _psnr(context: Compression, scene: ScenePlayer) -> float:
    """Of the scene as it is played, on the validation images."""
    device = context.training.gaussians.device

    def played(time_: float) -> TorchGaussians:
        arrays = vars(scene.at(time_)).values()
        return GaussianArrays(*(torch.from_numpy(np.array(array)).to(device) for array in arrays))

    return context.evaluator(played).now
