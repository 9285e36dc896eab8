"""The steps of a training, with what is said, saved and mended on the way."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..capacity_report import reduction_line
from ..errors import FrogError
from ..files import write_atomically
from ..inference.draw import to_uint8
from . import events
from .capacity_picture import capacity_picture
from .events import Event
from .recovery import Recovery
from .rescue import Checkpoints, save_somewhere
from .running_loss import Unstable
from .saving import fit_budget
from .trainer import Trainer

if TYPE_CHECKING:
    from .job import TrainingJob

_EVENT_SECONDS = 0.5  # between progress events
_EVALUATIONS = 10  # over a training
KEPT = ("seed", "scale", "holdout_frames", "pixel_offsets", "lossless", "max_bytes")
"""Fields of a job that a resume takes over."""


def train(job: TrainingJob, trainer: Trainer, scale: float, cancelled: Callable[[], bool]) -> Iterator[Event]:
    """Trains from where ``trainer`` stands to its end, or until ``cancelled``, and saves; see ``job.run_training``."""
    preview_shot = next((i for i, s in enumerate(trainer.capture.shots) if trainer.capture.is_test(s)), 0)
    checkpoints = Checkpoints(job, _settings(job))
    recovery = Recovery(trainer, checkpoints.settings)
    try:
        yield from _steps(job, trainer, recovery, checkpoints, cancelled, preview_shot)
    except Exception:
        checkpoints.keep(recovery.state)
        raise
    trainer.check()
    yield from checkpoints.save(trainer)  # before anything that may go wrong with the scene
    if trainer.finished:
        fit_budget(job, trainer, scale)
    elif job.max_bytes:
        yield events.Warned("The budget of bytes holds for a finished training; this one was cancelled.")
    psnr, split = trainer.evaluate(30)
    yield events.Evaluated(trainer.step_count, psnr, split, trainer.seconds)
    place, scene = yield from save_somewhere(job, trainer, scale, {"psnr": psnr, "split": split})
    yield events.Saved(str(place))
    if trainer.finished:
        figures = (trainer.step_count, trainer.seconds, psnr, trainer.count)
        if trainer.parsimony:
            yield from _capacity_picture(place, trainer, preview_shot)
        yield events.Finished(str(place), *figures, scene.header.capacity)
    else:
        yield events.Cancelled(trainer.step_count, str(place))


def _steps(
    job: TrainingJob,
    trainer: Trainer,
    recovery: Recovery,
    checkpoints: Checkpoints,
    cancelled: Callable[[], bool],
    preview_shot: int,
) -> Iterator[Event]:
    last_event = last_save = time.monotonic()
    evaluated = int(trainer.progress * _EVALUATIONS)
    while not trainer.finished and not cancelled():
        try:
            trainer.step()
            saving = time.monotonic() - last_save >= job.save_seconds
            if trainer.finished or int(trainer.progress * _EVALUATIONS) > evaluated:
                recovery.remember(trainer)
            elif saving:
                trainer.check()
        except (Unstable, RuntimeError, MemoryError) as error:
            yield events.Warned(recovery.go_back(trainer, error))
            evaluated = int(trainer.progress * _EVALUATIONS)
            continue
        yield from _reductions(trainer)
        now = time.monotonic()
        if now - last_event >= _EVENT_SECONDS or trainer.finished:
            last_event = now
            yield _progress_event(trainer)
        if int(trainer.progress * _EVALUATIONS) > evaluated and not trainer.finished:
            evaluated = int(trainer.progress * _EVALUATIONS)
            psnr, split = trainer.evaluate(job.evaluated_shots)
            yield events.Evaluated(trainer.step_count, psnr, split, trainer.seconds)
            yield events.Preview(trainer.step_count, to_uint8(trainer.picture(preview_shot)))
        if saving:
            yield from checkpoints.save(trainer)
            last_save = time.monotonic()


def _capacity_picture(scene: Path, trainer: Trainer, shot: int) -> Iterator[Event]:
    """Beside the scene, for people; what cannot be written costs nothing else."""
    import cv2

    path = scene.with_suffix(".capacity.png")
    picture = capacity_picture(trainer, shot)
    try:
        write_atomically(path, cv2.imencode(".png", picture[:, :, ::-1])[1].tobytes())
    except FrogError as error:
        yield events.Warned(str(error))
        return
    yield events.Pictured(str(path), picture)


def _reductions(trainer: Trainer) -> Iterator[Event]:
    """What the last step's round did, if it was one."""
    for reduction in trainer.parsimony.news() if trainer.parsimony else ():
        yield events.Reduced(trainer.step_count, reduction_line(asdict(reduction)))


def _progress_event(trainer: Trainer) -> events.Progress:
    share = max(trainer.progress, 1e-9)
    return events.Progress(
        trainer.step_count,
        trainer.limits.steps or round(trainer.step_count / share),
        trainer.seconds,
        trainer.seconds * (1 - share) / share,
        trainer.loss,
        trainer.count,
        trainer.model.canonical.moving,
    )


def _settings(job: TrainingJob) -> dict[str, Any]:
    """What a resume takes over from this job."""
    settings = {name: getattr(job, name) for name in (*KEPT, "steps", "seconds")}
    return {**settings, "max_gaussians": job.recipe.max_gaussians}
