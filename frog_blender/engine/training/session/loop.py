"""The steps of a training, with the events, checkpoints and recoveries on the way, and the scene at the end."""

import math
import time
from collections.abc import Generator, Iterator
from pathlib import Path

from ...errors import FrogError, reason
from ...scene.compression_report import reduction_line
from ...scene.header import SceneHeader
from ..compression.context import compression_of
from ..compression.schedule import CompressionFailed
from ..optimize.training import TrainingDiverged
from . import events
from .checkpoint import restore
from .events import Event
from .export import EVALUATED_SHOTS, Metrics, build_scene, fit_budget, remove_non_finite
from .fallback_save import Checkpoints, save_with_fallback
from .live_scene import Rest
from .output_paths import checkpoint_path
from .pictures import Previews, snapshot
from .recovery import Recovery
from .session import Session
from .time_estimate import COMPRESSING, MEASURING, SAVING

_EVALUATIONS = 10  # over a training


def train(session: Session) -> Iterator[Event]:
    """Trains from where the session stands to its end, or until it is cancelled, and saves; see
    ``run.run_training``."""
    trainer, output = session.trainer, session.job.output
    began = trainer.step_count
    checkpoints = Checkpoints(checkpoint_path(output), began)
    recovery = Recovery(trainer, session.job.stored_settings())
    trainer.add_hook(recovery)
    try:
        while True:
            try:
                yield from _steps(session, recovery, checkpoints)
                session.clock.end("training")
                if trainer.step_count == began and not trainer.finished:  # there is nothing new to write
                    yield events.Cancelled(began, str(output) if output.is_file() and session.job.resume else None)
                    return
                written, header = yield from _export(session, recovery)
                break
            except CompressionFailed as failed:
                message = recovery.without_milestone(failed)
            except (RuntimeError, MemoryError, TrainingDiverged) as error:
                message = recovery.rollback(error)
            yield events.WarningEvent(message)
        if told := checkpoints.write_last(recovery.last_state, None if trainer.finished else trainer.store):
            yield events.WarningEvent(told)
    except Exception as error:
        checkpoints.write_last(recovery.last_state, trainer.store)
        if isinstance(error, TrainingDiverged):  # after every rollback: what the user can mend
            raise FrogError(error) from error
        raise
    finally:
        trainer.hooks.remove(recovery)
    path = str(written)
    yield events.Saved(path)
    if not trainer.finished:
        yield events.Cancelled(trainer.step_count, path)
        return
    session.clock.end("finishing")
    figures = (trainer.step_count, trainer.seconds, header.metrics.get("psnr"), trainer.count, dict(header.capacity))
    yield events.Finished(path, *figures, session.clock.seconds)


def _steps(session: Session, recovery: Recovery, checkpoints: Checkpoints) -> Iterator[Event]:
    """Trains to the end or until it is cancelled; then the checkpoint is as new as the training."""
    job, trainer, cancel = session.job, session.trainer, session.cancel
    last_event = last_save = time.monotonic()
    evaluated = int(trainer.progress * _EVALUATIONS)
    previews, live, rest = Previews(session), job.live, Rest()
    while not trainer.finished:
        ended, paused = cancel.ended, cancel.paused  # asked once: a pause that comes later holds the next step
        # A pause may last for days: before it, what was learned goes to disk.
        saves = paused or time.monotonic() - last_save >= job.save_every
        if ended:
            break
        if trainer.step_count != checkpoints.step and saves:
            yield from _progress_events(session)
            yield from _save(recovery, checkpoints)
            last_event = last_save = time.monotonic()
        if paused and cancel():
            continue  # the others are told that it ends
        if live is not None and live.is_wanted and rest.is_over:
            try:
                with rest.measured():
                    live.offer(snapshot(session))
            except Exception as error:  # the training does not need it
                live = None
                yield events.WarningEvent(f"The training cannot be shown while it runs ({reason(error)}).")
        # The last milestone belongs to the last step, after which nothing tells of steps any more.
        compresses = compression_of(trainer) is not None and trainer.step_count + 1 == trainer.steps
        if compresses:
            yield from _progress_events(session)
            yield events.Stage(COMPRESSING, 0, 1)
        trainer.step()
        yield from _compression_events(session)
        now = time.monotonic()
        if not compresses and (now - last_event >= job.event_seconds or trainer.finished):
            last_event = now
            yield from _progress_events(session)
        a_tenth = int(trainer.progress * _EVALUATIONS) > evaluated and not trainer.finished
        if a_tenth:
            evaluated = int(trainer.progress * _EVALUATIONS)
            recovery.snapshot()
            psnr, split = trainer.evaluate(job.evaluated_shots)
            yield events.Evaluated(trainer.step_count, psnr, split, trainer.seconds)
        if a_tenth or (previews.due and not trainer.finished):
            yield from previews.render()
    if trainer.step_count == checkpoints.step:  # the checkpoint is up to date, or there was no step yet
        recovery.snapshot()
    else:
        yield from _save(recovery, checkpoints)


def _save(recovery: Recovery, checkpoints: Checkpoints) -> Iterator[Event]:
    """Writes a checkpoint; ``snapshot`` first refuses a state that is not finite."""
    recovery.snapshot()
    yield from checkpoints.save(recovery.last_state)


def _export(session: Session, recovery: Recovery) -> Generator[Event, None, tuple[Path, SceneHeader]]:
    """Writes the scene; returns where, and its header. Whatever optional part fails is left out with a warning."""
    trainer, job = session.trainer, session.job
    if compression_of(trainer):
        yield events.Stage(COMPRESSING, 0, 1)
    try:
        fit_budget(session)
    except (FrogError, TrainingDiverged):  # a budget that cannot be met: the checkpoint resumes with a larger one
        raise
    except Exception as error:
        restore(trainer, recovery.last_state)
        yield events.WarningEvent(f"The budget could not be met ({reason(error)}): all Gaussians were saved.")
    if job.max_bytes and not trainer.finished:
        yield events.WarningEvent("The budget of bytes holds for a finished training; this one was cancelled.")
    metrics: Metrics = {}
    yield events.Stage(MEASURING, 0, 1)
    try:
        psnr, split = trainer.evaluate(EVALUATED_SHOTS)
        metrics = {"psnr": psnr, "split": split}
        yield events.Evaluated(trainer.step_count, psnr, split, trainer.seconds)
    except Exception as error:
        yield events.WarningEvent(f"The scene's quality could not be measured ({reason(error)}).")
    yield events.Stage(SAVING, 0, 1)
    remove_non_finite(session.trainer.gaussians)
    scene, content, warning = build_scene(session, metrics)
    if warning:
        yield events.WarningEvent(warning)
    written = yield from save_with_fallback(job.output, content, trainer.store)
    return written, scene.header


def _compression_events(session: Session) -> Iterator[Event]:
    """What the last step's compression did, if any was due."""
    compression = compression_of(session.trainer)
    for step in compression.new_steps() if compression else ():
        yield events.Reduced(session.trainer.step_count, reduction_line(step.to_json()))


def _progress_events(session: Session) -> Iterator[Event]:
    trainer = session.trainer
    yield events.Progress(
        trainer.step_count,
        trainer.steps or round(trainer.step_count / max(trainer.progress, 1e-9)),
        trainer.seconds,
        0.0,  # see RunProgress
        trainer.loss,
        trainer.count,
        trainer.gaussians.num_dynamic,
    )
    losses = {name: float(part) for name, part in trainer.loss_terms.items()}
    finite = {name: part for name, part in losses.items() if math.isfinite(part)}  # others JSON does not have
    rates = {group["name"]: float(group["lr"]) for group in trainer.optimizer.adam.param_groups}
    yield events.Statistics(trainer.step_count, finite, rates, trainer.gaussians.added, trainer.gaussians.removed)
