"""Which attributes of those that move have to change, in a finished scene.

Most Gaussians that are deformed keep their shape (they move, fade and take on colours), and where things move fast many
only fade: they are there for some moments, and hardly stir while they are. What need not change stands still in its
mean over the moments at which the Gaussian is seen (docs/experiments/compression.md).
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
import torch

from ...field.opacity_tracks import quantize_opacities
from ...playback.player import ScenePlayer
from ...rasterizer import GaussianArrays
from ...scene.header import SHAPE_DYNAMIC
from ...scene.quantization import pack
from ...scene.scene_file import OPACITY_TRACKS, SceneFile
from ..optimize.gaussian_order import mask_excluding
from .finalize import has_transients, in_groups, in_order, milliseconds_between, played_by
from .schedule import CompressionSchedule, CompressionStep
from .sensitivity import FAINT, SHAPE, STATE
from .validation import largest_count_within

if TYPE_CHECKING:
    from ..optimize.trainer import Trainer

ALLOWED_FADING_LOSS, ALLOWED_SHAPE_LOSS = 0.03, 0.015
"""dB on the withheld images that it may cost when some only fade, and when some keep their shape."""
_FADING_WORTH_IT, _SHAPE_WORTH_IT = 0.1, 0.25  # of those that move: fewer are not worth another kind of Gaussian
_LONGEST = 256  # frames; an embedding says more in less where there are more
_MOMENTS = 32  # at most, that a mean is taken over


def freeze_attributes(
    rounds: CompressionSchedule, trainer: Trainer, scene: SceneFile
) -> tuple[SceneFile, list[CompressionStep]]:
    """The scene without changes of attributes that the withheld images do not miss, and what that saved; the scene
    itself where nothing is known of those that move, or few would be spared."""
    if not rounds.motion or not in_groups(scene):
        return scene, []
    reductions, motion = list[CompressionStep](), rounds.motion
    if scene.header.frame_count <= _LONGEST and has_transients(scene):
        scene, who, reductions = _fade_some(rounds, trainer, scene, motion.fade_energy)
        motion = motion.of(mask_excluding(who, len(motion.score)))
    if not in_groups(scene):  # all of them fade
        return scene, reductions
    scene, shapes = _keep_shapes(rounds, trainer, scene, motion.shape_energy)
    return scene, reductions + shapes


def _fade_some(
    rounds: CompressionSchedule, trainer: Trainer, scene: SceneFile, energy: torch.Tensor
) -> tuple[SceneFile, torch.Tensor, list[CompressionStep]]:
    """Lets those only fade whose other changes are not missed, if the file does not grow by it; and who they are."""
    playable, count = ScenePlayer(scene), len(energy)
    state = _seen_state(playable)
    who, loss = _spared(rounds, trainer, playable, energy, state, STATE, ALLOWED_FADING_LOSS)
    chosen, tracks = who.cpu().numpy(), _tracks(playable)
    embeddings, tracks = scene.arrays["embeddings"][chosen], tracks[chosen]
    smaller = pack(OPACITY_TRACKS, tracks).content.size <= pack("embeddings", embeddings).content.size
    if len(who) < max(1, _FADING_WORTH_IT * count) or not smaller:
        return scene, who[:0], []
    arrays = _in_state(scene, chosen, state, STATE)
    brightest = tracks.max(axis=1).clip(1, 254) / 255
    arrays["opacity_logits"][chosen] = np.log(brightest / (1 - brightest))
    found = _last_of_movers(SceneFile(scene.header, arrays), chosen)
    deformed = found.arrays["embeddings"][: count - len(chosen)]
    found = SceneFile(found.header, found.arrays | {"embeddings": deformed, OPACITY_TRACKS: tracks})
    saved = embeddings.nbytes - tracks.nbytes
    faster = milliseconds_between(playable, ScenePlayer(found))
    return found, who, [CompressionStep("only fade", 1.0, count, count - len(who), loss, faster, saved)]


def _keep_shapes(
    rounds: CompressionSchedule, trainer: Trainer, scene: SceneFile, energy: torch.Tensor
) -> tuple[SceneFile, list[CompressionStep]]:
    """Lets those keep their shape of which that is not missed."""
    playable, count = ScenePlayer(scene), len(energy)
    state = _seen_state(playable)
    who, loss = _spared(rounds, trainer, playable, energy, state, SHAPE, ALLOWED_SHAPE_LOSS)
    if len(who) < max(1, _SHAPE_WORTH_IT * count):
        return scene, []
    chosen = who.cpu().numpy()
    header = replace(scene.header, model=scene.header.model | {SHAPE_DYNAMIC: count - len(chosen)})
    found = _last_of_movers(SceneFile(header, _in_state(scene, chosen, state, SHAPE)), chosen)
    faster = milliseconds_between(playable, ScenePlayer(found))
    return found, [CompressionStep("keep their shape", 1.0, count, count - len(who), loss, faster)]


def _spared(
    rounds: CompressionSchedule,
    trainer: Trainer,
    playable: ScenePlayer,
    energy: torch.Tensor,
    state: dict[str, np.ndarray],
    names: tuple[str, ...],
    allowed: float,
) -> tuple[torch.Tensor, float]:
    """Indices, ascending, of those deformed whose attributes ``names`` may be as in ``state``, and what that costs."""
    still = {name: torch.from_numpy(state[name]).to(trainer.device) for name in names}
    judge, order = rounds.judge(trainer, played=played_by(playable, trainer.device)), energy.argsort()

    def loss(number: int) -> float:
        chosen = ~mask_excluding(order[:number], len(energy))
        return judge.loss(lambda gaussians: replace(gaussians, **_where(chosen, still, gaussians)))

    number, lost = largest_count_within(loss, judge.expected(energy[order]), allowed)
    return order[:number].sort().values, lost


def _where(chosen: torch.Tensor, still: dict[str, torch.Tensor], gaussians: GaussianArrays) -> dict[str, torch.Tensor]:
    """Attributes by name, of the first Gaussians as in ``still`` where ``chosen`` is true."""
    changed, count = {}, len(chosen)
    for name, values in still.items():
        now = getattr(gaussians, name)
        where = chosen.view(-1, *[1] * (now.dim() - 1))
        changed[name] = torch.cat([torch.where(where, values[:count], now[:count]), now[count:]])
    return changed


def _moments(playable: ScenePlayer, most: int) -> list[int]:
    """Frames, spread over all of them."""
    frames = playable.header.frame_count
    return np.unique(np.linspace(0, frames - 1, min(frames, most)).round().astype(int)).tolist()


def _seen_state(playable: ScenePlayer) -> dict[str, np.ndarray]:
    """How those that move look (GaussianArrays, by name), in the mean over frames weighed by squared opacity."""
    count, total = playable.num_dynamic, 0.0
    sums: dict[str, np.ndarray | float] = dict.fromkeys(STATE, 0.0)
    for frame in _moments(playable, _MOMENTS):
        gaussians = playable.at_frame(frame)
        weight = gaussians.opacities[:count].clip(FAINT) ** 2
        total = total + weight
        for name in STATE:
            values = getattr(gaussians, name)[:count]
            sums[name] = sums[name] + values * _as_wide(weight, values)
    return {name: np.asarray(value) / _as_wide(np.asarray(total), np.asarray(value)) for name, value in sums.items()}


def _as_wide(weight: np.ndarray, values: np.ndarray) -> np.ndarray:
    return weight.reshape(-1, *[1] * (values.ndim - 1))


def _tracks(playable: ScenePlayer) -> np.ndarray:
    """(M, frames) of those that move, see model.fading."""
    frames = range(playable.header.frame_count)
    return np.stack(
        [quantize_opacities(playable.at_frame(frame).opacities[: playable.num_dynamic]) for frame in frames], axis=1
    )


def _in_state(
    scene: SceneFile, who: np.ndarray, state: dict[str, np.ndarray], names: tuple[str, ...]
) -> dict[str, np.ndarray]:
    """The scene's arrays, in which the attributes ``names`` of ``who`` are canonically as in ``state``."""
    arrays = {name: array.copy() for name, array in scene.arrays.items()}
    for name in names:
        values = state[name][who]
        if name == "scales":
            arrays["log_scales"][who] = np.log(values.clip(1e-12))
        else:
            arrays[name][who] = values
    return arrays


def _last_of_movers(scene: SceneFile, who: np.ndarray) -> SceneFile:
    """The scene in another order: of those that are deformed, ``who`` come after the others."""
    deformed, everyone = len(scene.arrays["embeddings"]), np.arange(len(scene.arrays["means"]))
    others = np.delete(everyone[:deformed], who)
    return in_order(scene, np.concatenate([others, who, everyone[deformed:]]))
