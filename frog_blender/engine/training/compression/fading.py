"""Which dynamic Gaussians of a finished scene need no more than their opacity.

Where things move fast, many Gaussians are visible for a few frames, and hardly move then. All but their opacity is
frozen in its mean over the frames at which the Gaussian is seen (docs/experiments/compression.md).
"""

from __future__ import annotations

import numpy as np
import torch
from numpy.typing import NDArray

from ...field.names import CANONICAL
from ...field.opacity_tracks import quantize_opacities
from ...playback.player import ScenePlayer
from ...scene.compression_report import StepKind
from ...scene.quantization import pack
from ...scene.scene_file import OPACITY_TRACKS, SceneFile
from ..optimize.gaussian_order import mask_excluding
from .context import CompressionContext, CompressionStep
from .finalize import has_transients, in_groups, milliseconds_between, num_bytes, played_by
from .sensitivity import FAINT, STATE, in_state
from .validation import largest_count_within


def freeze_all_but_opacity(context: CompressionContext, scene: SceneFile) -> tuple[SceneFile, CompressionStep | None]:
    """The scene in which Gaussians of which the validation images miss nothing else only fade, and what that saved.

    The scene itself where nothing is known of its dynamic Gaussians, where few would be frozen, or where the file would
    grow.
    """
    motion, settings = context.record.motion, context.settings
    if not motion or not in_groups(scene) or scene.header.frame_count > settings.max_track_frames:
        return scene, None
    if not has_transients(scene, settings.max_visible):
        return scene, None
    player, count, order = ScenePlayer(scene), len(motion.fade_energy), motion.fade_energy.argsort()
    device, state = context.training.gaussians.device, seen_state(player, settings.num_mean_frames)
    frozen = {name: torch.from_numpy(values).to(device) for name, values in state.items()}
    evaluator = context.evaluator(played=played_by(player, device))

    def loss(number: int) -> float:
        chosen = ~mask_excluding(order[:number], count)
        return evaluator.loss(lambda gaussians: in_state(gaussians, chosen, frozen))

    number, lost = largest_count_within(loss, evaluator.expected(motion.fade_energy[order]), settings.max_fade_loss)
    if number < max(1, settings.min_fading * count):
        return scene, None
    chosen = order[:number].sort().values.cpu().numpy()
    tracks, spared = _tracks(player)[chosen], scene.arrays["embeddings"][chosen]
    if pack(OPACITY_TRACKS, tracks).content.size > pack("embeddings", spared).content.size:
        return scene, None
    found = with_tracks(SceneFile(scene.header, _in_state(scene, chosen, state)), chosen, tracks)
    saved = num_bytes(scene) - num_bytes(found)
    faster = milliseconds_between(player, ScenePlayer(found))
    return found, CompressionStep(StepKind.ONLY_FADE, 1.0, count, count - number, lost, faster, saved)


def with_tracks(scene: SceneFile, chosen: NDArray[np.int64], tracks: NDArray[np.uint8]) -> SceneFile:
    """The scene in which the deformed Gaussians ``chosen`` (ascending) have opacity tracks instead, behind the others
    that are deformed.

    Args:
        tracks: (len(chosen), frames).
    """
    arrays, deformed = dict(scene.arrays), len(scene.arrays["embeddings"])
    others = np.delete(np.arange(deformed), chosen)
    order = np.concatenate([others, chosen, np.arange(deformed, len(arrays["means"]))])
    brightest = tracks.max(axis=1).clip(1, 254) / 255
    logits = arrays["opacity_logits"].copy()
    logits[chosen] = np.log(brightest / (1 - brightest))
    arrays["opacity_logits"] = logits
    arrays |= {name: arrays[name][order] for name in CANONICAL}
    arrays["embeddings"] = arrays["embeddings"][others]
    return SceneFile(scene.header, arrays | {OPACITY_TRACKS: tracks})


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
    scene: SceneFile, indices: NDArray[np.int64], state: dict[str, NDArray[np.float32]]
) -> dict[str, NDArray[np.float32]]:
    """The scene's arrays, in which ``indices`` are canonically as in ``state``."""
    arrays = {name: array.copy() for name, array in scene.arrays.items()}
    for name in STATE:
        values = state[name][indices]
        if name == "scales":
            arrays["log_scales"][indices] = np.log(values.clip(1e-12))
        else:
            arrays[name][indices] = values
    return arrays
