"""The steps of a training, with what is said, saved and mended on the way."""

from __future__ import annotations

import time
from collections.abc import Generator, Iterator
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ...errors import FrogError, reason
from ...io.atomic_files import write_atomically
from ...scene.compression_report import reduction_line
from ...scene.scene_file import SceneFile, settings_json
from ..compression.report_image import draw_report_image
from ..compression.schedule import CompressionFailed
from ..optimize.running_loss import TrainingDiverged
from ..optimize.trainer import Trainer
from . import events
from .cancel_token import CancelToken
from .checkpoint import restore
from .events import Event
from .export import EVALUATED, build_scene, bytes_at_most, drop_broken, fit_budget
from .fallback_save import Checkpoints, Room, save_with_fallback
from .output_paths import beside
from .preview import Previews, watched_shot
from .recovery import Recovery
from .time_estimate import Workload

if TYPE_CHECKING:
    from .job import TrainingJob

_EVENT_SECONDS = 0.5  # between progress events
_EVALUATIONS = 10  # over a training
KEPT: dict[str, Any] = {
    "method": str,
    "seed": int,
    "scale": int | float | None,
    "holdout_frames": int | None,
    "pixel_offsets": dict | None,
    "lossless": bool,
    "max_bytes": int | None,
    "steps": int | None,
    "seconds": int | float | None,
}
"""Fields of a job that a resume takes over besides its recipe, and what they are."""


def train(job: TrainingJob, trainer: Trainer, scale: float, control: CancelToken) -> Iterator[Event]:
    """Trains from where ``trainer`` stands to its end, or until ``control`` says so, and saves; see
    ``job.run_training``."""
    began = trainer.step_count
    checkpoints, room = Checkpoints(job, began), Room(job.output, bytes_at_most(job, trainer, scale), trainer.store)
    recovery = Recovery(trainer, _settings(job))
    trainer.before_round = lambda: recovery.remember(trainer)
    try:
        while True:
            try:
                yield from _steps(job, trainer, recovery, checkpoints, control)
                if trainer.step_count == began and not trainer.finished:  # there is nothing new to write
                    yield events.Cancelled(began, str(job.output) if job.output.is_file() and job.resume else None)
                    return
                place, scene = yield from _scene(job, trainer, scale, recovery, room)
                break
            except CompressionFailed as failed:
                said = recovery.without_round(trainer, failed)
            except (TrainingDiverged, RuntimeError, MemoryError) as error:
                said = recovery.rollback(trainer, error)
            yield events.WarningEvent(said)
        yield from checkpoints.save_late(recovery.state, None if trainer.finished else room)
    except Exception:
        checkpoints.keep(recovery.state, room)
        raise
    finally:
        room.give_back()
        trainer.before_round = lambda: None  # the other one would hold on to the trainer, its frames and their lock
    yield events.Saved(str(place))
    if not trainer.finished:
        yield events.Cancelled(trainer.step_count, str(place))
        return
    if trainer.compression:
        yield from _capacity_image(place, trainer, watched_shot(trainer.capture) or 0)
    psnr = scene.header.metrics.get("psnr")
    yield events.Finished(str(place), trainer.step_count, trainer.seconds, psnr, trainer.count, scene.header.capacity)


def _steps(
    job: TrainingJob, trainer: Trainer, recovery: Recovery, checkpoints: Checkpoints, control: CancelToken
) -> Iterator[Event]:
    """Trains to the end or until it is to end; then the checkpoint is as new as the training."""
    last_event = last_save = time.monotonic()
    evaluated = int(trainer.progress * _EVALUATIONS)
    previews, work = Previews(job, control), Workload.of(trainer.capture, trainer.recipe, trainer.limits.steps)
    while not trainer.finished and not control.ended:
        paused = control.paused  # asked once: a pause that comes later holds the next step
        # Before a pause, which may last for days, what was learned goes to disk.
        if trainer.step_count != checkpoints.step and (paused or time.monotonic() - last_save >= job.save_seconds):
            yield _progress_event(trainer, work)
            yield from _save(trainer, recovery, checkpoints)
            last_event = last_save = time.monotonic()
        if paused and control():
            break
        trainer.step()
        yield from _reductions(trainer)
        now = time.monotonic()
        if now - last_event >= _EVENT_SECONDS or trainer.finished:
            last_event = now
            yield _progress_event(trainer, work)
        a_tenth = int(trainer.progress * _EVALUATIONS) > evaluated and not trainer.finished
        if a_tenth:
            evaluated = int(trainer.progress * _EVALUATIONS)
            recovery.remember(trainer)
            psnr, split = trainer.evaluate(job.evaluated_shots)
            yield events.Evaluated(trainer.step_count, psnr, split, trainer.seconds)
        if a_tenth or (previews.due and not trainer.finished):
            yield from previews.draw(trainer)
    if trainer.step_count == checkpoints.step:  # it knows all; before the first step there is nothing to know
        recovery.remember(trainer)
    else:
        yield from _save(trainer, recovery, checkpoints)


def _save(trainer: Trainer, recovery: Recovery, checkpoints: Checkpoints) -> Iterator[Event]:
    """Only what is good to go back to is written."""
    recovery.remember(trainer)
    yield from checkpoints.save(recovery.state)


def _scene(
    job: TrainingJob, trainer: Trainer, scale: float, recovery: Recovery, room: Room
) -> Generator[Event, None, tuple[Path, SceneFile]]:
    """Writes the scene; where it is, and what it holds. Nothing that may be left out can cost it."""
    try:
        fit_budget(job, trainer, scale)
    except FrogError:  # a budget that cannot be kept: the checkpoint is there for a larger one
        raise
    except Exception as error:
        restore(trainer, recovery.state)
        yield events.WarningEvent(f"The budget could not be kept ({reason(error)}): all Gaussians were saved.")
    if job.max_bytes and not trainer.finished:
        yield events.WarningEvent("The budget of bytes holds for a finished training; this one was cancelled.")
    metrics: dict[str, Any] = {}
    try:
        psnr, split = trainer.evaluate(EVALUATED)
        metrics = {"psnr": psnr, "split": split}
        yield events.Evaluated(trainer.step_count, psnr, split, trainer.seconds)
    except Exception as error:
        yield events.WarningEvent(f"How good the scene is could not be measured ({reason(error)}).")
    drop_broken(trainer)
    built = build_scene(job, trainer, scale, metrics)
    if built.said:
        yield events.WarningEvent(built.said)
    place = yield from save_with_fallback(job.output, built.content, room)
    return place, built.scene


def _capacity_image(scene: Path, trainer: Trainer, shot: int) -> Iterator[Event]:
    """Beside the scene, for people; what cannot be drawn or written costs nothing else."""
    import cv2

    path = beside(scene.with_suffix(""), ".capacity.png")
    try:
        image = draw_report_image(trainer, shot)
        write_atomically(path, cv2.imencode(".png", image[:, :, ::-1])[1].tobytes())
    except Exception as error:
        yield events.WarningEvent(f"There is no image of what moves and what rests ({reason(error)}).")
        return
    yield events.CompressionPreview(str(path), image)


def _reductions(trainer: Trainer) -> Iterator[Event]:
    """What the last step's round did, if it was one."""
    for reduction in trainer.compression.news() if trainer.compression else ():
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
        trainer.model.canonical.num_dynamic,
    )


def _settings(job: TrainingJob) -> dict[str, Any]:
    """What a resume takes over from this job, and whose it is."""
    settings = {name: getattr(job, name) for name in KEPT}
    return {**settings, "recipe": settings_json(job.recipe), "capture": str(Path(job.capture).resolve())}
