"""A training from folder to file, as a stream of events that command line and Blender share."""

from __future__ import annotations

from .. import passive_threads  # noqa: F401

# isort: split
import os
import queue
import threading
from collections.abc import Callable, Generator, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, TypeVar

from ...capture.capture import Capture
from ...capture.frames import FrameStore
from ...capture.readers import open_capture
from ...capture.seed_store import stored_seeds
from ...capture.seeds import Seeds
from ...errors import FrogError
from ...io.atomic_files import check_writable, remove_partial_files
from ...memory import gc_frozen
from ..methods import method_named
from ..optimize.device import choose_device
from ..optimize.initialization import doubt_of_scale
from ..optimize.trainer import Limits, Trainer
from ..recipe import Recipe, recipe
from . import events
from .cancel_token import CancelToken
from .checkpoint import checkpoint_path, load_checkpoint
from .events import Event
from .export import check_budget, check_readable
from .loop import train
from .output_lock import claimed
from .output_paths import check_unused
from .resume import restore_job
from .time_estimate import pixels_of, usual_scale

Result = TypeVar("Result")
_PATIENCE = 10.0  # seconds, for work before training that nobody waits for any more


@dataclass(frozen=True)
class TrainingJob:
    """What to train.

    Attributes:
        capture: the capture's folder.
        output: the ``.frog`` to write; its checkpoint lies beside it.
        method: one of ``methods.METHODS``.
        recipe: the settings.
        steps, seconds: limits; the recipe's steps when neither is given.
        seed: of everything random.
        scale: image size factor; None shrinks to at most 1600 pixels a side.
        holdout_frames: withhold every n-th moment; None keeps what the format says.
        overwrite: replace a scene, or a checkpoint, that lies at ``output``; otherwise that is refused.
        resume: go on from the checkpoint beside ``output``, with the method, recipe and other settings that it began
            with; only ``steps``, ``seconds`` and ``max_bytes`` can be set anew.
        chosen: of the settings those that somebody chose, and how they call them (``--seed``): a resume says which of
            them it leaves aside.
        pixel_offsets: see ``open_capture``.
        lossless: write every number as it is, instead of packed where that shows nowhere.
        max_bytes: of the file, at most; only with the recipe's capacity "auto".
        device: "auto", "cpu" or "cuda", see ``choose_device``; a resume may choose another.
        opened: the capture itself, where it is not what ``open_capture`` makes of the folder (a segment, a protocol's
            own split).
        evaluated_shots: images that each evaluation on the way looks at, at most.
        save_seconds: between checkpoints; what a killed training loses at most.
        preview_camera: whose view the previews show, see ``preview.watched_shot``.
        preview_seconds: between previews, at most; every tenth of the training has one besides.
    """

    capture: Path
    output: Path
    method: str = "frog"
    recipe: Recipe = field(default_factory=lambda: recipe("standard"))
    steps: int | None = None
    seconds: float | None = None
    seed: int = 0
    scale: float | None = None
    holdout_frames: int | None = None
    overwrite: bool = True
    resume: bool = False
    chosen: Mapping[str, str] = field(default_factory=dict)
    pixel_offsets: dict[str, tuple[float, float]] | None = None
    device: str = "auto"
    lossless: bool = False
    max_bytes: int | None = None
    opened: Capture | None = None
    evaluated_shots: int = 6
    save_seconds: float = 180.0
    preview_camera: str | None = None
    preview_seconds: float = 10.0


def prepare_capture(
    path: Path,
    scale: float | None,
    holdout_frames: int | None,
    pixel_offsets: dict[str, tuple[float, float]] | None,
    opened: Capture | None = None,
) -> tuple[Capture, float]:
    """The capture as it will be trained on or evaluated, and the scale that was used.

    Args:
        opened: the capture itself, instead of what the folder holds.
    """
    capture = opened if opened is not None else open_capture(Path(path), pixel_offsets=pixel_offsets)
    if scale is None:
        scale = usual_scale(capture.cameras)
    if scale != 1.0:
        capture = capture.scaled(scale)
    if holdout_frames is not None:
        capture = capture.with_holdout(holdout_frames)
    return capture, scale


def run_training(job: TrainingJob, cancelled: Callable[[], bool] = lambda: False) -> Iterator[Event]:
    """Trains, yielding events; the last is Finished or Cancelled. FrogError for what the user can mend.

    Cancelling keeps what was learned: a scene that plays and a checkpoint that resumes.

    Args:
        cancelled: asked between steps; a ``CancelToken`` can pause as well.
    """
    _check_output(job.output)
    with claimed(job.output):
        yield from _run(job, CancelToken.of(cancelled))


def _run(job: TrainingJob, control: CancelToken) -> Iterator[Event]:
    """``run_training`` once nobody else writes the output."""
    if not (job.overwrite or job.resume):
        check_unused(job.output)
    for path in (job.output, checkpoint_path(job.output)):
        remove_partial_files(path)
    if job.resume:  # what does not fit is said before minutes of decoding
        job, said = restore_job(job)
        if said:
            yield events.WarningEvent(said)
    adapted = method_named(job.method).adapt(job.recipe)
    if job.max_bytes and (adapted.capacity != "auto" or job.lossless):
        raise FrogError("A budget of bytes needs FRoG with automatic capacity, and a file that may be packed.")
    capture, scale = prepare_capture(job.capture, job.scale, job.holdout_frames, job.pixel_offsets, job.opened)
    device, said_of_it = choose_device(job.device)
    for warning in (*capture.warnings, *([said_of_it] if said_of_it else [])):
        yield events.WarningEvent(warning)
    if control():
        yield events.Cancelled(0, None)
        return
    store = yield from _in_background(
        "Decoding frames", lambda report: FrameStore.open(capture, progress=report, cancelled=control), control
    )
    seeds = None
    if store is not None:
        seeds = yield from _in_background(
            "Finding seed points", lambda report: _seeds(job, capture, store, report), control
        )
    if store is None or seeds is None:
        yield events.Cancelled(0, None)
        return
    limits = Limits(job.steps or (None if job.seconds else job.recipe.steps_for(capture.frame_count)), job.seconds)
    trainer = Trainer(capture, store, seeds, job.recipe, job.method, limits, job.seed, device)
    if job.resume:
        load_checkpoint(checkpoint_path(job.output), trainer)
    check_readable(job, trainer, scale)
    for doubt in (doubt_of_scale(trainer.scene_scale), check_budget(job, trainer, scale)):
        if doubt:
            yield events.WarningEvent(doubt)
    counts = (len(capture.cameras), capture.frame_count, trainer.count)
    pixels = round(pixels_of(capture.cameras))
    yield events.Started(job.method, limits.steps, *counts, device.type, pixels)
    with gc_frozen():
        yield from train(job, trainer, scale, control)


def _seeds(job: TrainingJob, capture: Capture, store: FrameStore, report: Callable[[int, int], None]) -> Seeds:
    limit = min(job.recipe.seed_gaussians, job.recipe.max_gaussians)
    return stored_seeds(capture, store, count_limit=limit, seed=job.seed, share=job.recipe.seed_share, progress=report)


def _check_output(output: Path) -> None:
    """FrogError where no file can lie: said now, and not when hours of training are to be saved."""
    if os.path.isdir(output):  # asks of names of any length
        raise FrogError(f"{output}: found a folder, expected the name of a .frog file to write.")
    if output.suffix != ".frog":
        raise FrogError(f"{output}: found the ending {output.suffix!r}, expected a file that ends in .frog.")
    try:
        output.parent.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise FrogError(f"{output.parent}: the folder could not be made ({error.strerror}).") from error
    for path in (output, checkpoint_path(output)):
        check_writable(path)


class _Stopped(Exception):
    """Ends work before training at its next report."""


def _in_background(
    name: str, work: Callable[[Callable[[int, int], None]], Result], cancelled: Callable[[], bool]
) -> Generator[Event, None, Result | None]:
    """Runs ``work(report)`` in a thread, yields its reports as Stage events, returns its result (None if cancelled)."""
    reports: queue.Queue[tuple[int, int]] = queue.Queue()
    outcome: dict[str, Any] = {}
    abandoned = threading.Event()

    def report(done: int, total: int) -> None:
        if abandoned.is_set() or cancelled():
            raise _Stopped
        reports.put((done, total))

    def run() -> None:
        try:
            outcome["result"] = work(report)
        except BaseException as error:
            outcome["error"] = error

    thread = threading.Thread(target=run, name=f"frog: {name}", daemon=True)
    thread.start()
    try:
        while thread.is_alive() or not reports.empty():
            try:
                done, total = reports.get(timeout=0.1)
            except queue.Empty:
                continue
            while not reports.empty():  # only the newest matters
                done, total = reports.get_nowait()
            yield events.Stage(name, done, total)
    finally:  # of whoever does not listen to the end, nothing half-made is to be left
        abandoned.set()
        thread.join(_PATIENCE)
    if "error" in outcome and not cancelled():
        raise outcome["error"]
    return None if cancelled() else outcome.get("result")
