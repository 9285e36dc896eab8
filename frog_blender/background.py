"""Training in the background: a worker thread, a queue of events, and ``pump()`` which applies them on the main thread.

The worker never touches Blender.  In a window a timer pumps; headless runs and tests, where timers do not fire, call
``pump()`` in a loop.  ``pump()`` never waits and does a bounded amount of work.
"""

from __future__ import annotations

import atexit
import queue
import sys
import threading
import time
import traceback
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import bpy
from bpy.app.handlers import persistent

from . import app_handlers
from .engine import memory
from .engine.capacity_report import lines, summary
from .engine.errors import FrogError
from .engine.training.control import Control
from .ui import preview_picture

PUMP_EVENTS = 200  # the most events one pump() applies
PUMP_SECONDS = 0.008  # and the longest it goes on taking new ones: half a frame of a 60 Hz window
TIMER_SECONDS = 0.1
JOIN_SECONDS = 120.0  # a cancelled training finishes its step and writes its scene

EventSource = Callable[[Control], Iterator[Any]]


class TrainingRequest:
    """What to train, in plain values.

    Args:
        recipe, capacity: names; None leaves the capacity to the recipe.
        job: fields of the engine's ``TrainingJob`` that are not to have their defaults. They are not repeated here,
            and the class itself is not named: its module imports torch.
    """

    def __init__(
        self, capture: Path, output: Path, recipe: str = "standard", capacity: str | None = None, **job: Any
    ) -> None:
        self.capture, self.output, self.recipe, self.capacity, self.job = capture, output, recipe, capacity, job

    def events(self, control: Control) -> Iterator[Any]:
        """Run the training; called on the worker, because this is what imports torch."""
        # torch would import Triton, which nothing here needs: its LLVM and Blender's own in one process end in a crash.
        sys.modules.setdefault("triton", None)  # type: ignore[arg-type]
        from .engine.training.estimate import remembering
        from .engine.training.job import TrainingJob, run_training
        from .engine.training.recipe import recipe

        settings = recipe(self.recipe, capacity=self.capacity)
        job = TrainingJob(self.capture, self.output, recipe=settings, **self.job)
        return remembering(run_training(job, control), job)


@dataclass
class TrainingState:
    """What the panel shows.  Only ``pump()`` writes it, so it needs no lock."""

    running: bool = True
    stage: str = "Starting"
    stage_fraction: float = 0.0
    step: int = 0
    steps: int = 0
    seconds: float = 0.0
    seconds_left: float = 0.0
    loss: float | None = None
    gaussians: int = 0
    moving: int = 0
    capacity: list[str] = field(default_factory=list)  # what was taken out of the model, a line each
    psnr: float | None = None
    psnr_split: str = ""
    preview: Any = None  # (H, W, 3) uint8, the latest
    warnings: list[str] = field(default_factory=list)
    result: Path | None = None  # the finished scene, or what a cancelled training left
    cancelled: bool = False
    error: str = ""

    @property
    def fraction(self) -> float:
        """How much of the present stage is done, 0 to 1."""
        return self.step / self.steps if self.steps and not self.stage else self.stage_fraction


class TrainingTask:
    """One training: ``start()`` it, ``pump()`` it until ``state.running`` is false.

    ``control`` pauses, resumes and cancels it at any time.
    """

    def __init__(self, source: EventSource, on_finished: Callable[[Path], None] | None = None) -> None:
        self.state = TrainingState()
        self._source = source
        self._on_finished = on_finished
        self.waiting: Path | None = None  # a finished file that is to be handed over
        self._events: queue.Queue[Any] = queue.Queue()
        self.control = Control()
        # A daemon, because Python waits for other threads before it runs atexit, where this one is asked to end.
        self._thread = threading.Thread(target=self._work, name="FRoG training", daemon=True)

    def start(self) -> TrainingTask:
        self._thread.start()
        return self

    def cancel(self) -> None:
        """Ask the worker to end, paused or not; it still writes what it has."""
        self.control.cancel()

    @property
    def paused(self) -> bool:
        """True while a running training is held."""
        return self.state.running and self.control.paused

    def join(self, seconds: float = JOIN_SECONDS) -> bool:
        """Wait for the worker; true if it ended."""
        if self._thread.is_alive():
            self._thread.join(seconds)
        return not self._thread.is_alive()

    def _work(self) -> None:
        try:
            for event in self._source(self.control):
                self._events.put(event)
        except FrogError as error:
            self._events.put(_Ended(str(error)))
        except BaseException as error:
            traceback.print_exc(file=sys.stderr)
            self._events.put(_Ended(f"Training stopped by an unforeseen {type(error).__name__}: {error}."))
        else:
            self._events.put(_Ended(""))
        finally:
            memory.give_back()

    def pump(self, most: int = PUMP_EVENTS) -> int:
        """Apply waiting events to ``state``: at most ``most``, for at most about PUMP_SECONDS.  Returns how many."""
        deadline = time.perf_counter() + PUMP_SECONDS
        for done in range(most):
            try:
                event = self._events.get_nowait()
            except queue.Empty:
                return done
            self._apply(event)
            if time.perf_counter() > deadline:
                return done + 1
        return most

    def _apply(self, event: Any) -> None:
        from .engine.training import events as kinds

        state = self.state
        match event:
            case kinds.Progress():
                state.stage = ""
                state.step, state.steps, state.loss = event.step, event.steps, event.loss
                state.seconds, state.seconds_left = event.seconds, event.seconds_left
                state.gaussians, state.moving = event.gaussians, event.moving
            case kinds.Reduced():
                state.capacity.append(event.message)
            case kinds.Pictured():
                state.preview = event.image
            case kinds.Stage():
                state.stage, state.stage_fraction = event.name.capitalize(), event.done / max(event.total, 1)
            case kinds.Started():
                state.stage, state.steps, state.gaussians = "", event.steps or 0, event.gaussians
            case kinds.Evaluated():
                state.psnr, state.psnr_split = event.psnr, event.split
            case kinds.Preview():
                state.preview = event.image
            case kinds.Warned():
                state.warnings.append(event.message)
            case kinds.Finished():
                state.step, state.steps, state.seconds = event.steps, event.steps, event.seconds
                state.gaussians, state.result = event.gaussians, Path(event.path)
                if event.capacity:
                    state.moving = event.capacity["dynamic"]
                    state.capacity = [summary(event.capacity), *lines(event.capacity)]
                state.psnr = event.psnr if event.psnr is not None else state.psnr
            case kinds.Cancelled():
                state.cancelled = True
                state.result = Path(event.path) if event.path else None
            case _Ended():
                state.error = state.error or event.error
                state.running = False
                if state.result and not state.error and not state.cancelled:
                    self.waiting = state.result
                    self.hand_over()

    def hand_over(self) -> None:
        """Gives a finished training's file to who asked for it, once no render looks at the scene that it changes."""
        if self.waiting is None or bpy.app.is_job_running("RENDER"):
            return
        result, self.waiting = self.waiting, None
        try:
            if self._on_finished is not None:
                self._on_finished(result)
        except FrogError as error:
            self.state.error = str(error)


@dataclass(frozen=True)
class _Ended:
    """The worker's last message; an empty error means that it came to its own end."""

    error: str


current: TrainingTask | None = None  # the training that the panel shows: running, or the last one that ran


def begin(source: EventSource, on_finished: Callable[[Path], None] | None = None) -> TrainingTask:
    """Start a training as the current one, pumped by a timer; FrogError if one is running already."""
    global current
    if is_running():
        raise FrogError("A training is running already; wait for it or cancel it first.")
    if current is not None and current.waiting:
        raise FrogError("The last training's scene comes in when the render ends; wait for it.")
    current = TrainingTask(source, on_finished).start()
    if not bpy.app.timers.is_registered(_tick):
        bpy.app.timers.register(_tick, first_interval=TIMER_SECONDS, persistent=True)
    return current


def is_running() -> bool:
    return current is not None and current.state.running


def is_paused() -> bool:
    return current is not None and current.paused


def stop() -> None:
    """Cancel the current training, wait for its worker and take in what it still said."""
    if current is None:
        return
    current.cancel()
    current._on_finished = None  # whoever stops a training does not want its result imported into what comes next
    if current.join():
        while current.pump():
            pass


def _tick() -> float | None:
    if current is None:
        return None
    applied = current.pump()
    if applied:
        preview_picture.show(current.state.preview)
        _redraw()
    current.hand_over()
    return TIMER_SECONDS if current.state.running or current.waiting else None


def _redraw() -> None:
    for window in bpy.context.window_manager.windows:
        for area in window.screen.areas:
            if area.type == "VIEW_3D":
                for region in area.regions:  # the sidebar alone: drawing the view again would cost the window more
                    if region.type == "UI":
                        region.tag_redraw()


@persistent
def _on_load_pre(*_: Any) -> None:
    stop()


def register() -> None:
    app_handlers.add([(bpy.app.handlers.load_pre, _on_load_pre)])
    atexit.register(stop)


def unregister() -> None:
    global current
    stop()
    current = None
    atexit.unregister(stop)
    app_handlers.remove([(bpy.app.handlers.load_pre, _on_load_pre)])
    if bpy.app.timers.is_registered(_tick):
        bpy.app.timers.unregister(_tick)
