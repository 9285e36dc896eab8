"""The steps of a training, with what is said, saved and mended on the way."""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..capacity_report import reduction_line
from ..errors import FrogError
from ..files import write_atomically
from . import events
from .capacity_picture import capacity_picture
from .control import Control
from .estimate import Workload
from .events import Event
from .preview import Previews, watched_shot
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


def train(job: TrainingJob, trainer: Trainer, scale: float, control: Control) -> Iterator[Event]:
    """Trains from where ``trainer`` stands to its end, or until ``control`` says so, and saves; see
    ``job.run_training``."""
    checkpoints = Checkpoints(job, _settings(job))
    recovery = Recovery(trainer, checkpoints.settings)
    try:
        yield from _steps(job, trainer, recovery, checkpoints, control)
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
            yield from _capacity_picture(place, trainer, watched_shot(trainer.capture) or 0)
        yield events.Finished(str(place), *figures, scene.header.capacity)
    else:
        yield events.Cancelled(trainer.step_count, str(place))


def _steps(
    job: TrainingJob, trainer: Trainer, recovery: Recovery, checkpoints: Checkpoints, control: Control
) -> Iterator[Event]:
    last_event = last_save = time.monotonic()
    evaluated = int(trainer.progress * _EVALUATIONS)
    previews, work = Previews(job, control), Workload.of(trainer.capture, trainer.recipe, trainer.limits.steps)
    while not trainer.finished and not control():
        try:
            trainer.step()
            # Before a pause, which may last for days, what was learned goes to disk.
            saving = control.paused or time.monotonic() - last_save >= job.save_seconds
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
        if now - last_event >= _EVENT_SECONDS or trainer.finished or saving:
            last_event = now
            yield _progress_event(trainer, work)
        a_tenth = int(trainer.progress * _EVALUATIONS) > evaluated and not trainer.finished
        if a_tenth:
            evaluated = int(trainer.progress * _EVALUATIONS)
            psnr, split = trainer.evaluate(job.evaluated_shots)
            yield events.Evaluated(trainer.step_count, psnr, split, trainer.seconds)
        if a_tenth or (previews.due and not trainer.finished):
            yield from previews.draw(trainer)
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


def _progress_event(trainer: Trainer, work: Workload) -> events.Progress:
    share = max(trainer.progress, 1e-9)
    # Late steps are dearer than early ones, unless the training is limited by time itself.
    done = share if trainer.limits.seconds else work.share_done(share)
    return events.Progress(
        trainer.step_count,
        trainer.limits.steps or round(trainer.step_count / share),
        trainer.seconds,
        trainer.seconds * (1 - done) / done,
        trainer.loss,
        trainer.count,
        trainer.model.canonical.moving,
    )


def _settings(job: TrainingJob) -> dict[str, Any]:
    """What a resume takes over from this job, and whose it is."""
    settings = {name: getattr(job, name) for name in (*KEPT, "steps", "seconds")}
    return {**settings, "max_gaussians": job.recipe.max_gaussians, "capture": str(Path(job.capture).resolve())}
