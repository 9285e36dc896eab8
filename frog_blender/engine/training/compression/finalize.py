"""A finished scene as its file plays it: Gaussians in the order that packs and plays best, and what that saves.

Where things move fast, many Gaussians are visible for a few frames, and hardly move then: they need no more than their
opacity. All else is frozen in its mean over the frames at which the Gaussian is seen (docs/experiments/compression.md).
"""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable

import numpy as np
import torch
from numpy.typing import NDArray

from ...field.names import CANONICAL
from ...field.opacity_tracks import quantize_opacities
from ...gaussians import TorchGaussians
from ...playback.deformation import DeformationPlayer
from ...playback.groups import mean_deformed_share, pack_group_bits, sort_by_visibility, visible_intervals
from ...playback.player import ScenePlayer, row_ranges
from ...rasterizer import GaussianArrays
from ...scene.compression_report import StepKind
from ...scene.quantization import morton_order_by_range, pack, unpack
from ...scene.scene_file import OPACITY_TRACKS, VISIBILITY, SceneFile, packed_arrays
from ..optimize.gaussian_state import mask_excluding
from .context import CompressionContext, CompressionStep
from .sensitivity import FAINT, STATE, in_state
from .settings import DEFAULT
from .validation import largest_count_within

_NUM_TIMED = 15  # frames


def reorder_for_playback(
    scene: SceneFile, finished: bool = True, max_visible: float = DEFAULT.max_visible
) -> SceneFile:
    """The scene with neighbours together, each kind of Gaussians in its place.

    When training is ``finished``, dynamic Gaussians that are visible at the same times come together, where that spares
    playback some of them; the array ``lifetimes`` says when (see playback.groups).
    """
    count, deformed, fading = (len(scene.arrays.get(name, ())) for name in ("means", "embeddings", OPACITY_TRACKS))
    bounds = sorted({deformed, deformed + fading} - {0, count})
    near = in_order(scene, morton_order_by_range(scene.arrays["means"], *bounds))
    if not finished or not has_transients(near, max_visible):
        return near
    lives = _lives(near)
    order = sort_by_visibility(lives)
    found = in_order(near, np.concatenate([order, np.arange(len(order), count)]))
    lives = lives[:, order] | _lives(as_packed(found))  # whose opacities differ a little
    return SceneFile(scene.header, found.arrays | {VISIBILITY: pack_group_bits(lives)})


def in_groups(scene: SceneFile) -> bool:
    """Whether playback deforms Gaussians of the scene in groups (see playback.groups), and it is FRoG's."""
    moves, header = len(scene.arrays.get("embeddings", ())), scene.header
    return bool(moves and header.method == "frog" and not header.model["head_width"])


def has_transients(scene: SceneFile, max_visible: float = DEFAULT.max_visible) -> bool:
    """Whether playback needs to deform clearly fewer Gaussians in a frame than there are."""
    if not in_groups(scene) or scene.header.frame_count < 2:
        return False
    lives = _lives(scene)
    return mean_deformed_share(pack_group_bits(lives[:, sort_by_visibility(lives)]), lives.shape[1]) <= max_visible


def as_packed(scene: SceneFile) -> SceneFile:
    """The scene with numbers as they come back from a packed file; FrogError where none can hold them."""
    packed = packed_arrays(scene.arrays)
    return SceneFile(scene.header, {name: unpack(each.content, each.description) for name, each in packed.items()})


def playback_steps(
    context: CompressionContext, scene: SceneFile, size: int, lost: float
) -> tuple[CompressionStep, CompressionStep | None]:
    """What packing a scene that was reordered into ``size`` bytes saves and costs, and what its lifetimes do, if any.

    Args:
        lost: dB that the scene itself is below the model.
    """
    packed = as_packed(scene)
    player = ScenePlayer(packed)
    always = ScenePlayer(SceneFile(packed.header, {k: v for k, v in packed.arrays.items() if k != VISIBILITY}))
    plain, psnr = num_bytes(scene), _psnr(context, always)
    loss = context.evaluator().now - lost - psnr
    packing = CompressionStep(StepKind.PACK, 1.0, plain, size, loss, bytes=plain - size)
    if VISIBILITY not in packed.arrays:
        return packing, None
    count = len(packed.arrays["embeddings"])
    deformed = round(count * mean_deformed_share(packed.arrays[VISIBILITY], count))
    loss, saved = psnr - _psnr(context, player), milliseconds_between(always, player)
    return packing, CompressionStep(StepKind.VISIBILITY, 1.0, count, deformed, loss, saved)


def _lives(scene: SceneFile) -> NDArray[np.bool_]:
    """(frames - 1, M) of the dynamic Gaussians, see playback.groups."""
    field = DeformationPlayer(scene.arrays, scene.header.model)
    return visible_intervals(lambda time_: field.at(time_).opacities[: field.deformed], scene.header.frame_count)


def in_order(scene: SceneFile, order: NDArray[np.int64]) -> SceneFile:
    """Its Gaussians in ``order``, in which deformed, fading and static ones stay in their places."""
    rows = row_ranges(scene.arrays)
    arrays = {n: array[order[rows[n]] - rows[n].start] if n in rows else array for n, array in scene.arrays.items()}
    return SceneFile(scene.header, arrays)


def num_bytes(scene: SceneFile) -> int:
    """Of its arrays as they are."""
    return sum(array.nbytes for array in scene.arrays.values())


def played_by(scene: ScenePlayer, device: torch.device) -> Callable[[float], TorchGaussians]:
    """Its Gaussians at a time in [0, 1], for torch."""

    def gaussians_at(time_: float) -> TorchGaussians:
        arrays = vars(scene.at(time_)).values()
        return GaussianArrays(*(torch.from_numpy(np.array(array)).to(device) for array in arrays))

    return gaussians_at


def _psnr(context: CompressionContext, scene: ScenePlayer) -> float:
    """Of the scene as it is played, on the validation images."""
    return context.evaluator(played=played_by(scene, context.training.gaussians.device)).now


def milliseconds_between(slow: ScenePlayer, fast: ScenePlayer) -> float:
    """By which a frame of the one takes longer, in the median of some frames at which they take turns."""
    longer = []
    for time_ in np.linspace(0, 1, _NUM_TIMED):
        started = time.perf_counter()
        slow.at(time_)
        between = time.perf_counter()
        fast.at(time_)
        longer.append(2 * between - started - time.perf_counter())
    return 1e3 * statistics.median(longer)


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
