"""A training's scene as a file: the arrays that playback needs, packed where that shows nowhere, and the report."""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import torch

from ...errors import FrogError, reason
from ...io.atomic_files import write_atomically
from ...model.canonical import ATTRIBUTES
from ...playback.player import CANONICAL, ScenePlayer, row_ranges
from ...scene.header import SceneHeader
from ...scene.scene_file import SceneFile, scene_bytes, settings_json
from ..compression.budget import fit_within, keep_within
from ..compression.finalize import arranged, compactions, played_by
from ..compression.schedule import CompressionSchedule, CompressionStep, heads_of
from ..compression.static_attributes import freeze_attributes
from ..optimize.gaussian_order import arrange

EVALUATED = 30  # images, at most, that a finished scene's PSNR is of
_REPORT_BYTES = 4000  # what is left out when a budget is measured: report, figures, times
_PACKING_LOSS = 0.05  # dB above which a file is not packed

if TYPE_CHECKING:
    from ..optimize.trainer import Trainer
    from .job import TrainingJob


def check_readable(job: TrainingJob, trainer: Trainer, scale: float) -> None:
    """FrogError, before a training begins, for a capture whose scene could be written but not opened again."""
    try:
        SceneHeader.from_json(_scene(job, trainer, scale, {}).header.to_json())
    except ValueError as error:
        raise FrogError(f"{job.capture}: no scene of this capture could be opened: found {error}.") from error


def check_budget(job: TrainingJob, trainer: Trainer, scale: float) -> str | None:
    """What is to be said, before a training begins, of a budget of bytes that may hold nothing; FrogError for one that
    not even a single Gaussian with an empty network meets."""
    if not job.max_bytes:
        return None
    scene, draw = _scene(job, trainer, scale, {}), np.random.default_rng(0)
    rows = row_ranges(scene.arrays)
    one = {name: array[:1] if name in rows else array for name, array in scene.arrays.items()}
    least = _size(SceneFile(scene.header, one))
    if least > job.max_bytes:
        raise FrogError(f"The budget of {job.max_bytes} bytes is too small: expected at least {least}.")
    # What is learned takes more than the zeros of before; how much of the network is needed shows late.
    learned = {name: draw.standard_normal(array.shape, np.float32) for name, array in one.items()}
    usual = _size(SceneFile(scene.header, learned))
    if usual <= job.max_bytes:
        return None
    return f"The budget of {job.max_bytes} bytes may be too small: the whole network takes {usual}."


def fit_budget(job: TrainingJob, trainer: Trainer, scale: float) -> None:
    """Leaves Gaussians out until the scene is within its limit and budgets; call it before the last evaluation.

    That of bytes holds for a finished training, since before its end much is not yet what it will be.
    """
    if trainer.compression:
        keep_within(trainer.compression, trainer, trainer.recipe.kept_at_most)
    if job.max_bytes and trainer.compression and trainer.finished:
        fit_within(
            trainer.compression, trainer, lambda: _size(arranged(_scene(job, trainer, scale, {}))), job.max_bytes
        )


def _size(scene: SceneFile) -> int:
    """Bytes of a packed file, at most; the same for the same training on any day."""
    header = replace(scene.header, train_seconds=0.0, capacity={})
    return len(scene_bytes(SceneFile(header, scene.arrays), compact=True)) + _REPORT_BYTES


@dataclass(frozen=True)
class Built:
    """A scene as it will lie on disk.

    Attributes:
        scene, content: what it holds, and the bytes of its file.
        said: a sentence where something optional failed and was left aside; else empty.
    """

    scene: SceneFile
    content: bytes
    said: str = ""


def save_scene(job: TrainingJob, trainer: Trainer, scale: float, metrics: dict[str, Any]) -> SceneFile:
    """Writes the ``.frog`` as training stands; see ``build_scene``."""
    built = build_scene(job, trainer, scale, metrics)
    write_atomically(job.output, built.content)
    return built.scene


def build_scene(job: TrainingJob, trainer: Trainer, scale: float, metrics: dict[str, Any]) -> Built:
    """The scene as training stands: packed with ``capacity="auto"``, unless it is to be lossless or packing shows.

    Whatever fails on the way to a smaller file, every number is kept as it is instead.
    """
    metrics = {name: value for name, value in metrics.items() if not isinstance(value, float) or math.isfinite(value)}
    if trainer.compression is None or job.lossless:
        return _as_it_is(job, trainer, scale, metrics)
    try:
        return _compact(job, trainer, trainer.compression, scale, metrics)
    except Exception as error:
        built = _as_it_is(job, trainer, scale, metrics)
        return replace(built, said=f"The scene could not be packed ({reason(error)}): every number is kept as it is.")


def _as_it_is(job: TrainingJob, trainer: Trainer, scale: float, metrics: dict[str, Any]) -> Built:
    try:
        scene = _scene(job, trainer, scale, metrics)
        return Built(scene, scene_bytes(scene))
    except Exception as error:  # figures that no header holds, a report that cannot be made
        scene = _scene(job, trainer, scale, {}, report=False)
        return Built(scene, scene_bytes(scene), f"The scene's file has no report ({reason(error)}).")


def _compact(
    job: TrainingJob, trainer: Trainer, rounds: CompressionSchedule, scale: float, metrics: dict[str, Any]
) -> Built:
    scene, found = _scene(job, trainer, scale, metrics), list[CompressionStep]()
    if trainer.finished and not job.max_bytes:  # which was met by the scene as it is
        scene, found = freeze_attributes(rounds, trainer, scene)
    scene = arranged(scene, trainer.finished)
    if found and "psnr" in metrics:  # of what is written
        psnr, _ = trainer.evaluate(EVALUATED, played_by(ScenePlayer(scene), trainer.device))
        scene = _with(scene, metrics={**metrics, "psnr": psnr})
    content = scene_bytes(scene, compact=True)
    if not trainer.finished:
        return Built(scene, content)
    lost = sum(reduction.loss or 0.0 for reduction in found)
    packed, unseen = compactions(rounds, trainer, scene, len(content), lost)
    compact = packed.loss is None or packed.loss <= _PACKING_LOSS or bool(job.max_bytes)
    found += [each for each in (packed if compact else None, unseen) if each]
    scene = _with(scene, capacity=_capacity(trainer, [*rounds.reductions, *found]))
    return Built(scene, scene_bytes(scene, compact=compact))


def _with(scene: SceneFile, **fields: Any) -> SceneFile:
    """The scene with other fields in its header."""
    return replace(scene, header=replace(scene.header, **fields))


def bytes_at_most(job: TrainingJob, trainer: Trainer, scale: float) -> int:
    """Of the scene's file, whatever the training still adds."""
    scene = _scene(job, trainer, scale, {})
    rows = row_ranges(scene.arrays)
    count = max(trainer.count, trainer.recipe.growth_limit_at(1.0))
    each = sum(array.nbytes / max(len(array), 1) for name, array in scene.arrays.items() if name in rows)
    rest = sum(array.nbytes for name, array in scene.arrays.items() if name not in rows)
    return int(count * each) + rest + len(scene.header.to_json()) + _REPORT_BYTES


def drop_broken(trainer: Trainer) -> None:
    """Leaves out Gaussians with a number that is none: nothing draws them, and no file should hold them."""
    canonical = trainer.model.canonical
    finite = torch.ones(trainer.count, dtype=torch.bool, device=trainer.device)
    for name in ATTRIBUTES:
        values = getattr(canonical, name).detach()
        rows = torch.isfinite(values).reshape(len(values), math.prod(values.shape[1:]))
        finite[: len(values)] &= rows.all(1)
    if bool(finite.any()) and not bool(finite.all()):
        kept = finite.nonzero().squeeze(1)
        movers = kept[kept < canonical.num_dynamic] if canonical.embeddings.shape[1] else kept
        arrange(trainer, kept, movers)


def _scene(
    job: TrainingJob, trainer: Trainer, scale: float, metrics: dict[str, Any], *, report: bool = True
) -> SceneFile:
    capture = trainer.capture
    shots: list[list[int]] = [[] for _ in capture.cameras]
    for shot in capture.shots:
        shots[shot.camera].append(shot.frame)
    moves = not trainer.compression or trainer.model.canonical.num_dynamic > 0
    header = SceneHeader(
        method=trainer.method,
        recipe=settings_json(trainer.recipe),
        model=trainer.model.stored_settings(trainer.schedule_state(trainer.progress)) if moves else {},
        cameras=capture.cameras,
        camera_shots=tuple(tuple(frames) for frames in shots),
        test_cameras=tuple(sorted(capture.test_cameras)),
        test_frames=tuple(sorted(capture.test_frames)),
        frame_count=capture.frame_count,
        frames_per_second=capture.frames_per_second,
        background=capture.background,
        capture_path=str(Path(job.capture).resolve()),
        capture_format=capture.format,
        scale=scale,
        pixel_offsets=dict(job.pixel_offsets or {}),
        metrics=metrics,
        steps=trainer.step_count,
        train_seconds=trainer.seconds,
        capacity=_capacity(trainer, trainer.compression.reductions) if trainer.compression and report else {},
    )
    return SceneFile(header, _arrays(trainer))


def _arrays(trainer: Trainer) -> dict[str, np.ndarray]:
    """What the file holds, by its names."""
    arrays = {}
    for name, value in trainer.model.state_dict().items():
        name = name.removeprefix("canonical.").replace("deformation.", "network.")
        arrays[name] = value.detach().cpu().numpy()
    if trainer.compression and not trainer.model.canonical.num_dynamic:  # then there is nothing for a network to do
        arrays = {name: array for name, array in arrays.items() if name in CANONICAL}
    elif not arrays["embeddings"].size:
        del arrays["embeddings"]
    return arrays


def _capacity(trainer: Trainer, reductions: list[CompressionStep]) -> dict[str, Any]:
    canonical = trainer.model.canonical
    return {
        "gaussians": trainer.count,
        "dynamic": canonical.num_dynamic,
        "heads": heads_of(trainer.model),
        "sh_degree": int(canonical.sh.shape[1] ** 0.5) - 1,
        "reductions": [asdict(reduction) for reduction in reductions],
    }
