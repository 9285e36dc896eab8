"""Which attributes of dynamic Gaussians have to change, in a finished scene.

Most dynamic Gaussians keep their shape (they move, fade and change colour), and where things move fast many only fade:
they are visible for a few frames, and hardly move then. What need not change is frozen in its mean over the frames at
which the Gaussian is seen (docs/experiments).
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import torch
from numpy.typing import NDArray

from ...field.opacity_tracks import quantize_opacities
from ...playback.player import ScenePlayer
from ...scene.compression_report import StepKind
from ...scene.header import SHAPE_DYNAMIC
from ...scene.quantization import pack
from ...scene.scene_file import OPACITY_TRACKS, SceneFile
from ..optimize.gaussian_order import mask_excluding
from .context import CompressionContext, CompressionStep
from .finalize import has_transients, in_groups, in_order, milliseconds_between, played_by
from .sensitivity import FAINT, SHAPE, STATE, in_state
from .validation import largest_count_within


def freeze_attributes(context: CompressionContext, scene: SceneFile) -> tuple[SceneFile, list[CompressionStep]]:
    """The scene without changes of attributes that the validation images do not miss, and what that saved; the scene
    itself where nothing is known of the dynamic Gaussians, or few would be frozen."""
    motion, settings = context.record.motion, context.settings
    steps = list[CompressionStep]()
    if not motion or not in_groups(scene):
        return scene, steps
    if scene.header.frame_count <= settings.max_track_frames and has_transients(scene, settings.max_visible):
        scene, indices, steps = _freeze_all_but_opacity(context, scene, motion.fade_energy)
        motion = motion.select(mask_excluding(indices, len(motion.score)))
    if not in_groups(scene):  # all of them only fade
        return scene, steps
    scene, shapes = _freeze_shape(context, scene, motion.shape_energy)
    return scene, steps + shapes


def _freeze_all_but_opacity(
    context: CompressionContext, scene: SceneFile, energy: torch.Tensor
) -> tuple[SceneFile, torch.Tensor, list[CompressionStep]]:
    """Gaussians whose other changes are not missed only fade, if the file does not grow by it; and their indices."""
    player, count, settings = ScenePlayer(scene), len(energy), context.settings
    state = seen_state(player, settings.num_mean_frames)
    indices, loss = _unmissed(context, player, energy, {name: state[name] for name in STATE}, settings.max_fade_loss)
    chosen, tracks = indices.cpu().numpy(), _tracks(player)
    embeddings, tracks = scene.arrays["embeddings"][chosen], tracks[chosen]
    smaller = pack(OPACITY_TRACKS, tracks).content.size <= pack("embeddings", embeddings).content.size
    if len(indices) < max(1, settings.min_fading * count) or not smaller:
        return scene, indices[:0], []
    arrays = _in_state(scene, chosen, state, STATE)
    brightest = tracks.max(axis=1).clip(1, 254) / 255
    arrays["opacity_logits"][chosen] = np.log(brightest / (1 - brightest))
    found = _last_of_dynamic(SceneFile(scene.header, arrays), chosen)
    deformed = found.arrays["embeddings"][: count - len(chosen)]
    found = SceneFile(found.header, found.arrays | {"embeddings": deformed, OPACITY_TRACKS: tracks})
    saved = embeddings.nbytes - tracks.nbytes
    faster = milliseconds_between(player, ScenePlayer(found))
    return found, indices, [CompressionStep(StepKind.ONLY_FADE, 1.0, count, count - len(indices), loss, faster, saved)]


def _freeze_shape(
    context: CompressionContext, scene: SceneFile, energy: torch.Tensor
) -> tuple[SceneFile, list[CompressionStep]]:
    """Gaussians whose changes of shape are not missed keep it."""
    player, count, settings = ScenePlayer(scene), len(energy), context.settings
    state = seen_state(player, settings.num_mean_frames)
    indices, loss = _unmissed(context, player, energy, {name: state[name] for name in SHAPE}, settings.max_shape_loss)
    if len(indices) < max(1, settings.min_rigid * count):
        return scene, []
    chosen = indices.cpu().numpy()
    header = replace(scene.header, model={**scene.header.model, SHAPE_DYNAMIC: count - len(chosen)})
    found = _last_of_dynamic(SceneFile(header, _in_state(scene, chosen, state, SHAPE)), chosen)
    faster = milliseconds_between(player, ScenePlayer(found))
    return found, [CompressionStep(StepKind.KEEP_SHAPE, 1.0, count, count - len(indices), loss, faster)]


def _unmissed(
    context: CompressionContext,
    player: ScenePlayer,
    energy: torch.Tensor,
    state: dict[str, NDArray[np.float32]],
    allowed: float,
) -> tuple[torch.Tensor, float]:
    """Indices, ascending, of dynamic Gaussians that may be as in ``state``, and what that costs."""
    device = context.training.gaussians.device
    frozen = {name: torch.from_numpy(values).to(device) for name, values in state.items()}
    evaluator, order = context.evaluator(played=played_by(player, device)), energy.argsort()

    def loss(number: int) -> float:
        chosen = ~mask_excluding(order[:number], len(energy))
        return evaluator.loss(lambda gaussians: in_state(gaussians, chosen, frozen))

    number, lost = largest_count_within(loss, evaluator.expected(energy[order]), allowed)
    return order[:number].sort().values, lost


def seen_state(player: ScenePlayer, most: int) -> dict[str, NDArray[np.float32]]:
    """How dynamic Gaussians look (GaussianArrays, by name), in the mean over at most ``most`` frames, weighted by
    squared opacity."""
    count, frames = player.num_dynamic, player.header.frame_count
    total: NDArray[np.float32] = np.zeros((), np.float32)
    sums: dict[str, NDArray[np.float32]] = {name: np.zeros((), np.float32) for name in STATE}
    for frame in np.unique(np.linspace(0, frames - 1, min(frames, most)).round()):
        gaussians = player.at_frame(int(frame))
        weight = np.square(gaussians.opacities[:count].clip(FAINT))
        total = total + weight
        for name in STATE:
            values = getattr(gaussians, name)[:count]
            sums[name] = sums[name] + values * _as_wide(weight, values)
    return {name: value / _as_wide(total, value) for name, value in sums.items()}


def _as_wide(weight: NDArray[np.float32], values: NDArray[np.float32]) -> NDArray[np.float32]:
    return weight.reshape(-1, *[1] * (values.ndim - 1))


def _tracks(player: ScenePlayer) -> NDArray[np.uint8]:
    """(M, frames) of the dynamic Gaussians, see field.opacity_tracks."""
    frames = range(player.header.frame_count)
    return np.stack(
        [quantize_opacities(player.at_frame(frame).opacities[: player.num_dynamic]) for frame in frames], axis=1
    )


def _in_state(
    scene: SceneFile, indices: NDArray[np.int64], state: dict[str, NDArray[np.float32]], names: tuple[str, ...]
) -> dict[str, NDArray[np.float32]]:
    """The scene's arrays, in which the attributes ``names`` of ``indices`` are canonically as in ``state``."""
    arrays = {name: array.copy() for name, array in scene.arrays.items()}
    for name in names:
        values = state[name][indices]
        if name == "scales":
            arrays["log_scales"][indices] = np.log(values.clip(1e-12))
        else:
            arrays[name][indices] = values
    return arrays


def _last_of_dynamic(scene: SceneFile, indices: NDArray[np.int64]) -> SceneFile:
    """The scene in another order: among the dynamic Gaussians, ``indices`` come after the others."""
    deformed, everyone = len(scene.arrays["embeddings"]), np.arange(len(scene.arrays["means"]))
    others = np.delete(everyone[:deformed], indices)
    return in_order(scene, np.concatenate([others, indices, everyone[deformed:]]))
