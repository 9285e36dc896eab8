"""A training from folder to file, as a stream of events that command line and Blender share."""

from __future__ import annotations

import math
import queue
import threading
from collections.abc import Callable, Generator, Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, TypeVar

from ..capture.capture import Capture
from ..capture.frames import FrameStore
from ..capture.readers import open_capture
from ..capture.seed_store import stored_seeds
from ..capture.seeds import Seeds
from ..errors import FrogError, found_instead
from ..files import remove_unfinished
from ..memory import old_objects_left_alone
from . import events
from .checkpoint import checkpoint_path, checkpoint_settings, load_checkpoint
from .control import Control
from .device import choose_device
from .estimate import pixels_of, usual_scale
from .events import Event
from .loop import KEPT, train
from .methods import method_named
from .recipe import Recipe, recipe, stored_recipe
from .saving import check_budget
from .start import doubt_of_scale
from .trainer import Limits, Trainer

Result = TypeVar("Result")


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
        scale: picture size factor; None shrinks to at most 1600 pixels a side.
        holdout_frames: withhold every n-th moment; None keeps what the format says.
        resume: go on from the checkpoint beside ``output``, with the method, recipe and other settings that it began
            with; only ``steps``, ``seconds`` and ``max_bytes`` can be set anew.
        pixel_offsets: see ``open_capture``.
        lossless: write every number as it is, instead of packed where that shows nowhere.
        max_bytes: of the file, at most; only with the recipe's capacity "auto".
        device: "auto", "cpu" or "cuda", see ``choose_device``; a resume may choose another.
        opened: the capture itself, where it is not what ``open_capture`` makes of the folder (a segment, a protocol's
            own split).
        evaluated_shots: pictures that each evaluation on the way looks at, at most.
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
    resume: bool = False
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
        cancelled: asked between steps; a ``Control`` can pause as well.
    """
    control = Control.of(cancelled)
    _check_output(job.output)
    if job.resume and not checkpoint_path(job.output).is_file():  # said before minutes of decoding
        raise found_instead(checkpoint_path(job.output), "no file", "a training checkpoint to go on from")
    if job.resume:
        asked, job = _described(job), _as_it_began(job)
        if _described(job) != asked:
            yield events.Warned(f"The training goes on as it began: {_described(job)}.")
    adapted = method_named(job.method).adapt(job.recipe)
    if job.max_bytes and (adapted.capacity != "auto" or job.lossless):
        raise FrogError("A budget of bytes needs FRoG with automatic capacity, and a file that may be packed.")
    capture, scale = prepare_capture(job.capture, job.scale, job.holdout_frames, job.pixel_offsets, job.opened)
    device, left_aside = choose_device(job.device)
    for warning in (*capture.warnings, *([left_aside] if left_aside else [])):
        yield events.Warned(warning)
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
    for doubt in (doubt_of_scale(trainer.scene_scale), check_budget(job, trainer, scale)):
        if doubt:
            yield events.Warned(doubt)
    counts = (len(capture.cameras), capture.frame_count, trainer.count)
    pixels = round(pixels_of(capture.cameras))
    yield events.Started(job.method, limits.steps, *counts, device.type, pixels)
    with old_objects_left_alone():
        yield from train(job, trainer, scale, control)


def _seeds(job: TrainingJob, capture: Capture, store: FrameStore, report: Callable[[int, int], None]) -> Seeds:
    limit = min(job.recipe.seed_gaussians, job.recipe.max_gaussians)
    return stored_seeds(capture, store, count_limit=limit, seed=job.seed, share=job.recipe.seed_share, progress=report)


def _as_it_began(job: TrainingJob) -> TrainingJob:
    """A resumed job with what it was started with; only the limits can be set anew."""
    path = checkpoint_path(job.output)
    before = checkpoint_settings(path)
    try:
        kept = {name: before[name] for name in KEPT}
        for name, value in kept.items():
            if not isinstance(value, KEPT[name]):
                raise ValueError(f"{name} is {value!r}")
        if not all(kept[name] is None or 0 < kept[name] < math.inf for name in ("steps", "seconds")):
            raise ValueError(f"{kept['steps']} steps, {kept['seconds']} seconds")
        if kept["pixel_offsets"]:
            kept["pixel_offsets"] = {name: (float(x), float(y)) for name, (x, y) in kept["pixel_offsets"].items()}
        if job.steps or job.seconds:
            kept |= {"steps": job.steps, "seconds": job.seconds}
        if job.max_bytes:
            kept["max_bytes"] = job.max_bytes
        return replace(job, **kept, recipe=stored_recipe(before["recipe"]))
    except (KeyError, ValueError, TypeError, AttributeError, FrogError) as error:
        raise found_instead(path, f"settings that do not fit ({error})", "a training checkpoint") from error


def _described(job: TrainingJob) -> str:
    return f"method {job.method}, recipe {job.recipe.name}, capacity {job.recipe.capacity}"


def _check_output(output: Path) -> None:
    """FrogError where no file can lie; unfinished ones of a killed training are removed."""
    if output.is_dir():
        raise FrogError(f"{output}: found a folder, expected the name of a .frog file to write.")
    try:
        output.parent.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise FrogError(f"{output.parent}: the folder could not be made ({error.strerror}).") from error
    for path in (output, checkpoint_path(output)):
        remove_unfinished(path)


class _Stopped(Exception):
    """Ends work before training at its next report."""


def _in_background(
    name: str, work: Callable[[Callable[[int, int], None]], Result], cancelled: Callable[[], bool]
) -> Generator[Event, None, Result | None]:
    """Runs ``work(report)`` in a thread, yields its reports as Stage events, returns its result (None if cancelled)."""
    reports: queue.Queue[tuple[int, int]] = queue.Queue()
    outcome: dict[str, Any] = {}

    def report(done: int, total: int) -> None:
        if cancelled():
            raise _Stopped
        reports.put((done, total))

    def run() -> None:
        try:
            outcome["result"] = work(report)
        except BaseException as error:
            outcome["error"] = error

    thread = threading.Thread(target=run, name=f"frog: {name}", daemon=True)
    thread.start()
    while thread.is_alive() or not reports.empty():
        try:
            done, total = reports.get(timeout=0.1)
        except queue.Empty:
            continue
        while not reports.empty():  # only the newest matters
            done, total = reports.get_nowait()
        yield events.Stage(name, done, total)
    thread.join()
    if "error" in outcome and not cancelled():
        raise outcome["error"]
    return None if cancelled() else outcome.get("result")
