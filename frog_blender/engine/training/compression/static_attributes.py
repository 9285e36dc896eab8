"""Which attributes of dynamic Gaussians have to change, in a finished scene.

Most dynamic Gaussians keep their shape (they move, fade and change colour), and where things move fast many only fade:
they are visible for a few frames, and hardly move then. What need not change is frozen in its mean over the frames at
which the Gaussian is seen (docs/experiments).
"""

from __future__ import annotations

import numpy as np
import torch
from numpy.typing import NDArray

from ...field.opacity_tracks import quantize_opacities
from ...playback.player import ScenePlayer
from ...scene.compression_report import StepKind
from ...scene.dynamics import KEEPS_SHAPE, ONLY_FADES, Dynamics, dynamics_of
from ...scene.quantization import pack
from ...scene.scene_file import OPACITY_TRACKS, SceneFile
from ..optimize.gaussian_order import mask_excluding
from .context import CompressionContext, CompressionStep
from .finalize import has_transients, in_groups, milliseconds_between, num_bytes, played_by, with_dynamics
from .sensitivity import FAINT, SHAPE, STATE, in_state
from .validation import largest_count_within


def freeze_attributes(context: CompressionContext, scene: SceneFile) -> tuple[SceneFile, list[CompressionStep]]:
    """The scene without changes of attributes that the validation images do not miss, and what that saved; the scene
    itself where nothing is known of the dynamic Gaussians, or few would be frozen."""
    motion, settings, steps = context.record.motion, context.settings, list[CompressionStep]()
    if not motion or not in_groups(scene):
        return scene, steps
    if scene.header.frame_count <= settings.max_track_frames and has_transients(scene, settings.max_visible):
        scene, chosen, steps = _freeze(context, scene, ONLY_FADES, motion.fade_energy)
        motion = motion.select(mask_excluding(chosen, len(motion.score)))
    if in_groups(scene):  # unless all of them only fade
        scene, _, shapes = _freeze(context, scene, KEEPS_SHAPE, motion.shape_energy)
        steps += shapes
    return scene, steps


def _freeze(
    context: CompressionContext, scene: SceneFile, left: Dynamics, energy: torch.Tensor
) -> tuple[SceneFile, torch.Tensor, list[CompressionStep]]:
    """The scene in which no more than ``left`` changes of Gaussians of which images miss nothing else, and their
    indices; none where they are few, or the file would grow.

    Args:
        energy: (M,) by how much images change without, of those of which everything changes.
    """
    settings, device, fades = context.settings, context.training.gaussians.device, left == ONLY_FADES
    names, kind = (STATE, StepKind.ONLY_FADE) if fades else (SHAPE, StepKind.KEEP_SHAPE)
    allowed = settings.max_fade_loss if fades else settings.max_shape_loss
    player, count, order = ScenePlayer(scene), len(energy), energy.argsort()
    state = seen_state(player, settings.num_mean_frames)
    frozen = {name: torch.from_numpy(state[name]).to(device) for name in names}
    evaluator = context.evaluator(played=played_by(player, device))

    def loss(number: int) -> float:
        chosen = ~mask_excluding(order[:number], count)
        return evaluator.loss(lambda gaussians: in_state(gaussians, chosen, frozen))

    number, lost = largest_count_within(loss, evaluator.expected(energy[order]), allowed)
    indices = order[:number].sort().values
    chosen, none = indices.cpu().numpy(), (scene, indices[:0], list[CompressionStep]())
    if number < max(1, (settings.min_fading if fades else settings.min_rigid) * count):
        return none
    arrays, dynamics = _in_state(scene, chosen, state, names), dynamics_of(scene)
    dynamics[chosen] = left
    if fades:
        tracks = _tracks(player)[chosen]
        spared = scene.arrays["embeddings"][chosen]
        if pack(OPACITY_TRACKS, tracks).content.size > pack("embeddings", spared).content.size:
            return none
        brightest = tracks.max(axis=1).clip(1, 254) / 255
        arrays["opacity_logits"][chosen] = np.log(brightest / (1 - brightest))
        arrays[OPACITY_TRACKS] = tracks
    found = with_dynamics(SceneFile(scene.header, arrays), dynamics)
    saved = num_bytes(scene) - num_bytes(found)
    faster = milliseconds_between(player, ScenePlayer(found))
    return found, indices, [CompressionStep(kind, 1.0, count, count - number, lost, faster, saved)]


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
