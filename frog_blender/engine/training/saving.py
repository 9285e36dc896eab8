"""A training's scene as a file: the arrays that playback needs, packed where that shows nowhere, and the report."""

from __future__ import annotations

import math
from dataclasses import asdict, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import torch

from ..atomic_files import write_atomically
from ..errors import FrogError
from ..files import SceneFile, SceneHeader, scene_bytes, settings_json
from ..inference.scene import CANONICAL, PlayableScene, rows_of
from ..model.canonical import ATTRIBUTES
from .attributes import spare_attributes
from .budget import fit_within, keep_within
from .compacting import arranged, compactions, played_by
from .parsimony import Reduction, heads_of
from .resting import arrange

EVALUATED = 30  # pictures, at most, that a finished scene's PSNR is of
_REPORT_BYTES = 4000  # what is left out when a budget is measured: report, figures, times
_PACKING_LOSS = 0.05  # dB above which a file is not packed

if TYPE_CHECKING:
    from .job import TrainingJob
    from .trainer import Trainer


def check_budget(job: TrainingJob, trainer: Trainer, scale: float) -> str | None:
    """What is to be said, before a training begins, of a budget of bytes that may hold nothing; FrogError for one that
    not even a single Gaussian with an empty network meets."""
    if not job.max_bytes:
        return None
    scene, draw = _scene(job, trainer, scale, {}), np.random.default_rng(0)
    rows = rows_of(scene.arrays)
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
    if trainer.parsimony:
        keep_within(trainer.parsimony, trainer, trainer.recipe.kept_at_most)
    if job.max_bytes and trainer.parsimony and trainer.finished:
        fit_within(trainer.parsimony, trainer, lambda: _size(arranged(_scene(job, trainer, scale, {}))), job.max_bytes)


def _size(scene: SceneFile) -> int:
    """Bytes of a packed file, at most; the same for the same training on any day."""
    header = replace(scene.header, train_seconds=0.0, capacity={})
    return len(scene_bytes(SceneFile(header, scene.arrays), compact=True)) + _REPORT_BYTES


def save_scene(job: TrainingJob, trainer: Trainer, scale: float, metrics: dict[str, Any]) -> SceneFile:
    """Writes the ``.frog`` as training stands: packed with ``capacity="auto"``, unless it is to be lossless or packing
    shows."""
    _drop_broken(trainer)
    compact = trainer.parsimony is not None and not job.lossless
    scene, found = _scene(job, trainer, scale, metrics), list[Reduction]()
    if compact:
        if trainer.parsimony and trainer.finished and not job.max_bytes:  # which was met by the scene as it is
            scene, found = spare_attributes(trainer.parsimony, trainer, scene)
        scene = arranged(scene, trainer.finished)
    if found and "psnr" in metrics:  # of what is written
        scene.header.metrics["psnr"], _ = trainer.evaluate(EVALUATED, played_by(PlayableScene(scene), trainer.device))
    content = scene_bytes(scene, compact=compact)
    if compact and trainer.parsimony and trainer.finished:
        lost = sum(reduction.loss or 0.0 for reduction in found)
        packed, unseen = compactions(trainer.parsimony, trainer, scene, len(content), lost)
        compact = packed.loss is None or packed.loss <= _PACKING_LOSS or bool(job.max_bytes)
        found += [each for each in (packed if compact else None, unseen) if each]
        scene.header.capacity["reductions"] += [asdict(reduction) for reduction in found]
        content = scene_bytes(scene, compact=compact)
    write_atomically(job.output, content)
    return scene


def _drop_broken(trainer: Trainer) -> None:
    """Leaves out Gaussians with a number that is none: nothing draws them, and no file should hold them."""
    canonical = trainer.model.canonical
    finite = torch.ones(trainer.count, dtype=torch.bool, device=trainer.device)
    for name in ATTRIBUTES:
        values = getattr(canonical, name).detach()
        rows = torch.isfinite(values).reshape(len(values), math.prod(values.shape[1:]))
        finite[: len(values)] &= rows.all(1)
    if bool(finite.any()) and not bool(finite.all()):
        kept = finite.nonzero().squeeze(1)
        movers = kept[kept < canonical.moving] if canonical.embeddings.shape[1] else kept
        arrange(trainer, kept, movers)


def _scene(job: TrainingJob, trainer: Trainer, scale: float, metrics: dict[str, Any]) -> SceneFile:
    capture = trainer.capture
    shots: list[list[int]] = [[] for _ in capture.cameras]
    for shot in capture.shots:
        shots[shot.camera].append(shot.frame)
    moves = not trainer.parsimony or trainer.model.canonical.moving > 0
    header = SceneHeader(
        method=trainer.method,
        recipe=settings_json(trainer.recipe),
        model=trainer.model.stored_settings(trainer.progressing(trainer.progress)) if moves else {},
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
        capacity=_capacity(trainer, trainer.parsimony.reductions) if trainer.parsimony else {},
    )
    return SceneFile(header, _arrays(trainer))


def _arrays(trainer: Trainer) -> dict[str, np.ndarray]:
    """What the file holds, by its names."""
    arrays = {}
    for name, value in trainer.model.state_dict().items():
        name = name.removeprefix("canonical.").replace("deformation.", "network.")
        arrays[name] = value.detach().cpu().numpy()
    if trainer.parsimony and not trainer.model.canonical.moving:  # then there is nothing for a network to do
        arrays = {name: array for name, array in arrays.items() if name in CANONICAL}
    elif not arrays["embeddings"].size:
        del arrays["embeddings"]
    return arrays


def _capacity(trainer: Trainer, reductions: list[Reduction]) -> dict[str, Any]:
    canonical = trainer.model.canonical
    return {
        "gaussians": trainer.count,
        "dynamic": canonical.moving,
        "heads": heads_of(trainer.model),
        "sh_degree": int(canonical.sh.shape[1] ** 0.5) - 1,
        "reductions": [asdict(reduction) for reduction in reductions],
    }
