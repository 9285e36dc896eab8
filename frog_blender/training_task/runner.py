"""Training in the background: a worker thread, a queue of events, and ``pump()`` which applies them on the main thread.

The worker never touches Blender, so it goes on while another file is opened.  In a window a timer pumps; headless runs
and tests, where timers do not fire, call ``pump()`` in a loop.  ``pump()`` never waits and does a bounded amount of
work.
"""

from __future__ import annotations

import atexit
import queue
import sys
import threading
import time
import traceback
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import bpy

from ..engine import memory
from ..engine.errors import FrogError, brief
from ..engine.training.session.cancel_token import CancelToken
from ..torch_install import folders
from ..ui import preview_image
from . import unsaved_changes
from .state import TrainingState

PUMP_EVENTS = 200  # the most events one pump() applies
PUMP_SECONDS = 0.008  # and the longest it goes on taking new ones: half a frame of a 60 Hz window
TIMER_SECONDS = 0.1
QUIT_SECONDS = 10.0  # what a cancelled training gets to finish its step and write its scene when Blender quits
PATIENCE = 0.5  # of which so many pass before a word is said
_JOBS = ("RENDER", "OBJECT_BAKE")  # of Blender's, that look at the scene in threads of their own

EventSource = Callable[[CancelToken], Iterator[Any]]
OnFinished = Callable[[Path], str | None]
"""Takes a finished scene's file; returns what the panel says besides, if anything. May raise FrogError."""


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

    def events(self, control: CancelToken) -> Iterator[Any]:
        """Run the training; called on the worker, because this is what imports torch."""
        folders.hold()
        from ..engine.training.recipe import recipe
        from ..engine.training.session.job import TrainingJob
        from ..engine.training.session.run import run_training
        from ..engine.training.session.time_estimate import remembering

        settings = recipe(self.recipe, capacity=self.capacity)
        job = TrainingJob(self.capture, self.output, recipe=settings, **self.job)
        return remembering(run_training(job, control), job)


class TrainingTask:
    """One training: ``start()`` it, ``pump()`` it until ``state.running`` is false.

    ``control`` pauses, resumes and cancels it at any time.
    """

    def __init__(self, source: EventSource, on_finished: OnFinished | None = None) -> None:
        self.state = TrainingState()
        self._source = source
        self._on_finished = on_finished
        self.waiting: Path | None = None  # a finished file that is to be handed over
        self._events: queue.Queue[Any] = queue.Queue()
        self.control = CancelToken()
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

    def join(self, seconds: float = QUIT_SECONDS) -> bool:
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
            memory.trim_heap()

    def pump(self, most: int = PUMP_EVENTS) -> int:
        """Apply waiting events to ``state``: at most ``most``, for at most about PUMP_SECONDS.  Returns how many."""
        deadline = time.perf_counter() + PUMP_SECONDS
        for done in range(most):
            try:
                event = self._events.get_nowait()
            except queue.Empty:
                if not self._has_died():
                    return done
                event = _Ended("The training stopped without giving a reason, possibly out of memory.")
            self._apply(event)
            if time.perf_counter() > deadline:
                return done + 1
        return most

    def _has_died(self) -> bool:
        """Whether the worker is gone and its last message, which only a lack of memory can swallow, never came."""
        gone = self.state.running and self._thread.ident is not None and not self._thread.is_alive()
        return gone and self._events.empty()  # asked last: it may have spoken just before it ended

    def _apply(self, event: Any) -> None:
        state = self.state
        if not isinstance(event, _Ended):
            try:
                state.take(event)
            except Exception as error:  # one that cannot be shown; those that follow are to be
                state.warnings.append(f"What the training said last cannot be shown ({brief(repr(error))}).")
            return
        state.error = state.error or event.error
        state.running = False
        if state.result and not state.error and not state.cancelled:
            self.waiting = state.result
            self.hand_over()

    def hand_over(self) -> None:
        """Gives a finished training's file to who asked for it, once nothing else works on the scene."""
        if self.waiting is None or any(map(bpy.app.is_job_running, _JOBS)) or unsaved_changes.is_being_changed():
            return
        result, self.waiting = self.waiting, None
        try:
            if self._on_finished is not None:
                self.state.note = self._on_finished(result) or ""
        except FrogError as error:
            self.state.error = str(error)
        except Exception as error:  # nobody else would hear of it, and the file is there
            traceback.print_exc(file=sys.stderr)
            self.state.error = f"{result}: it is trained, but could not be imported ({brief(repr(error))})."


@dataclass(frozen=True)
class _Ended:
    """The worker's last message; an empty error means that it came to its own end."""

    error: str


current: TrainingTask | None = None  # the training that the panel shows: running, or the last one that ran


def begin(source: EventSource, on_finished: OnFinished | None = None) -> TrainingTask:
    """Start a training as the current one, pumped by a timer; FrogError if one is running already."""
    global current
    if is_running():
        raise FrogError("A training is running already; wait for it or cancel it first.")
    if current is not None and current.waiting:
        raise FrogError("The last scene is still waiting to be imported; finish the current render or operation first.")
    task = TrainingTask(source, on_finished)
    try:
        current = task.start()
    except RuntimeError as error:  # the system has no thread left
        raise FrogError(f"The training could not be started ({error}).") from error
    if not bpy.app.timers.is_registered(_tick):
        bpy.app.timers.register(_tick, first_interval=TIMER_SECONDS, persistent=True)
    return current


def is_running() -> bool:
    return current is not None and current.state.running


def is_paused() -> bool:
    return current is not None and current.paused


def stop() -> None:
    """Cancel the current training, let it finish what it saves, for QUIT_SECONDS at most, and take in what it said."""
    if current is None:
        return
    current.cancel()
    current._on_finished = None  # whoever stops a training does not want its result imported into what comes next
    if not current.join(PATIENCE):
        has_learned = current.state.step > 0
        doing = "saving what the training has learned" if has_learned else "ending the training"
        _say_at_the_end(f"{doing}, which may take up to {QUIT_SECONDS:.0f} seconds.")
        if not current.join(QUIT_SECONDS - PATIENCE):
            kept = "; what the last checkpoint holds, if one was written, is kept" if has_learned else ""
            _say_at_the_end(f"it took longer{kept}.")
            return
    while current.pump():
        pass


def _say_at_the_end(sentence: str) -> None:
    print(f"FRoG: {sentence}", file=sys.stderr, flush=True)


def _tick() -> float | None:
    if current is None:
        return None
    try:
        if current.pump():
            preview_image.show(current.state.preview)
            _redraw()
        if current.state.running:
            unsaved_changes.count_as_unsaved()
    except Exception:  # Blender drops a timer that fails, and with it the rest of the training
        traceback.print_exc(file=sys.stderr)
        current.state.preview = None
    current.hand_over()
    return TIMER_SECONDS if current.state.running or current.waiting else None


def _redraw() -> None:
    for window in bpy.context.window_manager.windows:
        for area in window.screen.areas:
            if area.type == "VIEW_3D":
                for region in area.regions:  # the sidebar alone: drawing the view again would cost the window more
                    if region.type == "UI":
                        region.tag_redraw()


def register() -> None:
    atexit.register(stop)


def unregister() -> None:
    global current
    stop()
    current = None
    atexit.unregister(stop)
    if bpy.app.timers.is_registered(_tick):
        bpy.app.timers.unregister(_tick)
