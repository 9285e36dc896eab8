"""A training's scene as a file: the arrays that playback needs, packed where that shows nowhere, and the report."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import torch

from ..files import SceneFile, SceneHeader, scene_bytes, settings_json, write_atomically
from ..inference.scene import CANONICAL
from ..packing import ordered, pack, unpack
from .parsimony import Reduction, heads_of

_SPARE_BYTES = 300  # what the last line of the report takes

if TYPE_CHECKING:
    from .job import TrainingJob
    from .trainer import Trainer


def save_scene(job: TrainingJob, trainer: Trainer, scale: float, metrics: dict[str, Any]) -> SceneFile:
    """Writes the ``.frog`` as training stands; compactly with ``capacity="auto"``, unless it is to be lossless."""
    compact = trainer.parsimony is not None and not job.lossless
    if job.max_bytes and trainer.parsimony and trainer.finished:

        def size() -> int:
            return len(scene_bytes(_scene(job, trainer, scale, metrics, compact), compact=compact))

        trainer.parsimony.fit(trainer, size, job.max_bytes - _SPARE_BYTES)
    scene = _scene(job, trainer, scale, metrics, compact)
    content = scene_bytes(scene, compact=compact)
    if compact and trainer.parsimony and trainer.finished:
        plain = sum(array.nbytes for array in scene.arrays.values())
        loss = trainer.parsimony.loss_of(trainer, _unpacked)
        packed = Reduction("packed", 1.0, plain, len(content), loss, bytes=plain - len(content))
        scene.header.capacity["reductions"].append(asdict(packed))
        content = scene_bytes(scene, compact=True)
    write_atomically(job.output, content)
    return scene


def _scene(job: TrainingJob, trainer: Trainer, scale: float, metrics: dict[str, Any], compact: bool) -> SceneFile:
    arrays = _sorted(_arrays(trainer)) if compact else _arrays(trainer)
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
    return SceneFile(header, arrays)


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


def _sorted(arrays: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Neighbours together: those that move among themselves, and those at rest."""
    means, moving = arrays["means"], len(arrays.get("embeddings", ()))
    order = np.concatenate([ordered(means[:moving]), moving + ordered(means[moving:])])
    by_gaussian = CANONICAL | {"embeddings"}
    return {n: array[order[: len(array)]] if n in by_gaussian else array for n, array in arrays.items()}


def _unpacked(name: str, value: torch.Tensor) -> torch.Tensor:
    """A model's tensor as it comes back from a packed file."""
    packed = pack(name.removeprefix("canonical."), value.detach().cpu().numpy())
    return torch.from_numpy(unpack(packed.content, packed.description)).to(value)


def _capacity(trainer: Trainer, reductions: list[Reduction]) -> dict[str, Any]:
    canonical = trainer.model.canonical
    return {
        "gaussians": trainer.count,
        "dynamic": canonical.moving,
        "heads": heads_of(trainer.model),
        "sh_degree": int(canonical.sh.shape[1] ** 0.5) - 1,
        "reductions": [asdict(reduction) for reduction in reductions],
    }
