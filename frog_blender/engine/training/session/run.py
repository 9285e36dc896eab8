"""A training from the capture's folder to the scene's file, as a stream of events for any front end."""

from .. import passive_threads  # noqa: F401

# isort: split


import os
import threading
from collections import deque
from collections.abc import Callable, Generator, Iterator
from concurrent.futures import Future
from dataclasses import replace
from pathlib import Path
from typing import TypeVar

import torch

from ...capture.capture import Capture
from ...capture.readers import open_capture
from ...capture.seeds import Seeds, SeedSettings
from ...errors import FrogError, UsageError, in_words, reason, told_as
from ...frames.seed_store import stored_seeds
from ...frames.store import FrameStore
from ...io.atomic_files import check_writable, remove_partial_files
from ...memory import gc_frozen
from ...registry import METHODS, SINKS, guests_named
from ...scene.header import check_readable
from ..compression.budget import recipe_within
from ..compression.schedule import CompressionSchedule
from ..compression.settings import DEFAULT, CompressionSettings
from ..methods import fit_to
from ..optimize.device import choose_device
from ..optimize.hull_pruning import HullPruning, room_for_subject
from ..optimize.initialization import doubt_of_scale
from ..optimize.trainer import Trainer, TrainerFactory
from ..optimize.training import Training
from . import events
from .cancel_token import CancelToken
from .checkpoint import check_unchanged, load_checkpoint, restore_job
from .events import Event, Stage
from .export import check_budget, scene_as_it_stands
from .job import TrainingJob
from .loop import train
from .output_paths import check_unused, checkpoint_path, lock_output, training_progress
from .session import PhaseClock, Session
from .time_estimate import DECODING, SEEDING, RunProgress, Workload

Result = TypeVar("Result")
_MAX_WAIT = 10.0  # seconds for abandoned work to end
_TOLD_EVERY = 0.1  # seconds


class _Abandoned(Exception):
    """Ends the work at its next report."""


def in_background(
    name: str, work: Callable[[Callable[[int, int], None]], Result], cancelled: Callable[[], bool]
) -> Generator[Event, None, Result | None]:
    """Runs ``work(report)`` in a thread, yields its reports as Stage events and returns its result; None if cancelled.

    Raises:
        Exception: what ``work`` raised, unless it was cancelled.
    """
    newest = deque[tuple[int, int]](maxlen=1)  # of the reports, which alone matters
    abandoned, outcome = threading.Event(), Future[Result]()

    def report(done: int, total: int) -> None:
        if abandoned.is_set() or cancelled():
            raise _Abandoned
        newest.append((done, total))

    def run() -> None:
        try:
            outcome.set_result(work(report))
        except BaseException as error:
            outcome.set_exception(error)

    worker = threading.Thread(target=run, name=f"frog: {name}", daemon=True)
    worker.start()
    yield Stage(name, 0, 1)
    try:
        while worker.is_alive() or newest:
            worker.join(_TOLD_EVERY)
            if newest:
                yield Stage(name, *newest.pop())
    finally:  # nothing half-made is left when the caller stops listening
        abandoned.set()
        worker.join(_MAX_WAIT)
    return None if cancelled() else outcome.result()


def prepare_capture(job: TrainingJob) -> tuple[Capture, float]:
    """The capture as it will be trained on or evaluated, and the scale that was used."""
    capture = job.opened or open_capture(
        job.capture, pixel_offsets=job.pixel_offsets, masks=job.mask_settings, layout=job.layout
    )
    scale = capture.usual_scale if job.scale is None else job.scale
    capture = capture.scaled(scale)
    return (capture if job.holdout_frames is None else capture.with_holdout(job.holdout_frames)), scale


def run_training(
    job: TrainingJob,
    cancelled: Callable[[], bool] = lambda: False,
    *,
    trainer_type: TrainerFactory = Trainer,
) -> Iterator[Event]:
    """Trains, yielding events; the last is Finished or Cancelled.

    Cancelling keeps what was learned: a scene that plays and a checkpoint to resume from.

    Args:
        cancelled: asked between steps; a ``CancelToken`` can pause as well.
        trainer_type: what trains, for whoever watches its steps or changes them.

    Raises:
        FrogError: for what the user can mend.
    """
    cancel = cancelled if isinstance(cancelled, CancelToken) else CancelToken(cancelled)
    sinks = {name: SINKS[name] for name in job.sinks}
    _check_output(job.output)
    with lock_output(job.output), guests_named():
        if not (job.overwrite or job.resume):
            check_unused(job.output)
        for path in (job.output, checkpoint_path(job.output)):
            check_writable(path)
            remove_partial_files(path)
        for event in _run(job, cancel, trainer_type):
            for name, sink in list(sinks.items()):
                try:
                    sink(event)
                except Exception as error:  # of others' code: hours of training do not end for it
                    del sinks[name]
                    yield events.WarningEvent(f"The sink {name!r} is told no more: it failed ({reason(error)}).")
            yield event


def _run(job: TrainingJob, cancel: CancelToken, trainer_type: TrainerFactory) -> Iterator[Event]:
    """``run_training`` while the output is locked."""
    if job.resume:  # a checkpoint that does not fit is refused before minutes of decoding
        job, message = restore_job(job)
        if message:
            yield events.WarningEvent(message)
    else:
        job = replace(job, recipe=recipe_within(job.recipe, job))
    adapted = METHODS[job.method].adapted(job.recipe)
    if job.max_bytes and (adapted.capacity != "auto" or job.lossless):
        raise UsageError("A budget of bytes needs FRoG with automatic capacity, and a file that may be packed.")
    capture, scale = prepare_capture(job)
    if job.resume:
        check_unchanged(checkpoint_path(job.output), capture)
    clock = PhaseClock(cancel)
    device, fallback = choose_device(job.device)
    for warning in (*capture.warnings, *([fallback] if fallback else [])):
        yield events.WarningEvent(warning)
    if cancel():
        yield events.Cancelled(0, None)
        return
    recipe = fit_to(adapted, capture)
    begins, _ = (training_progress(job.output) if job.resume else None) or (0.0, 0)
    run = RunProgress(Workload.of(capture, recipe, job.steps), device.type, clock.now, job.seconds, begins)
    yield from run.following(_prepared(job, capture, scale, device, clock, trainer_type=trainer_type))


def _prepared(
    job: TrainingJob,
    capture: Capture,
    scale: float,
    device: torch.device,
    clock: PhaseClock,
    *,
    trainer_type: TrainerFactory,
) -> Iterator[Event]:
    """``_run`` from the first frame on."""
    cancel = clock.cancel
    store = yield from in_background(
        DECODING, lambda report: FrameStore.open(capture, progress=report, cancelled=cancel), cancel
    )
    clock.end("decoding")
    seeds = None
    if store is not None:
        seeds = yield from in_background(SEEDING, lambda report: seeds_of(job, capture, store, report), cancel)
    clock.end("seeding")
    if store is None or seeds is None:
        yield events.Cancelled(0, None)
        return
    trainer = trainer_type(capture, store, seeds, job.recipe, job, device)
    add_hooks(trainer, job.compression)
    if job.resume:
        load_checkpoint(checkpoint_path(job.output), trainer)
    session = Session(job, trainer, scale, cancel, clock)
    check_readable(job.capture, scene_as_it_stands(session).header)
    for doubt in (doubt_of_scale(trainer.scene_scale), check_budget(session)):
        if doubt:
            yield events.WarningEvent(doubt)
    counts = (len(capture.cameras), capture.frame_count, trainer.count)
    work = Workload.of(capture, trainer.recipe, trainer.steps)
    sizes = (trainer.device.type, round(work.pixels), work.images)
    yield events.Started(job.method, trainer.steps, *counts, *sizes, trainer.step_count)
    with gc_frozen():
        yield from train(session)


def add_hooks(training: Training, compression: CompressionSettings = DEFAULT) -> None:
    """What a training does besides its steps."""
    if training.recipe.capacity == "auto":
        training.add_hook(CompressionSchedule(compression))
    if training.mattes.has_alpha:
        training.add_hook(HullPruning())


def seeds_of(
    job: TrainingJob, capture: Capture, store: FrameStore, report: Callable[[int, int], None] = lambda done, total: None
) -> Seeds:
    """The seed points that a training starts from, searched for where no earlier one kept them.

    Args:
        report: called with how much of the search is done, and of how much.
    """
    if job.seeds is not None:
        return job.seeds
    limit = min(job.recipe.seed_gaussians, room_for_subject(capture, store, job.recipe.max_gaussians))
    recipe = fit_to(METHODS[job.method].adapted(job.recipe), capture)
    num_moments = recipe.moments_for(capture.frame_count, len(capture.train_shots))
    return stored_seeds(capture, store, SeedSettings(limit, job.seed, recipe.seed_share, num_moments), report)


@told_as(UsageError)
def _check_output(output: Path) -> None:
    """FrogError where no file can lie: now, rather than when hours of training are to be saved."""
    if os.path.isdir(output):  # takes names of any length
        raise FrogError(f"{output}: found a folder, expected the name of a .frog file to write.")
    if output.suffix != ".frog":
        raise FrogError(f"{output}: found the ending {output.suffix!r}, expected a file that ends in .frog.")
    with in_words(f"{output.parent}: the folder could not be made"):
        output.parent.mkdir(parents=True, exist_ok=True)
