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
from typing import TYPE_CHECKING, Any

import bpy

from .. import addon_state, redrawing
from ..engine import memory
from ..engine.errors import FrogError, brief
from ..engine.training.session.cancel_token import CancelToken
from ..timeline import prefetch
from . import unsaved_changes
from .state import TrainingState

if TYPE_CHECKING:
    from ..engine.training.session.events import Event

PUMP_EVENTS = 200  # the most events one pump() applies
PUMP_SECONDS = 0.008  # and the longest it takes: half a frame at 60 Hz
TIMER_SECONDS = 0.1
QUIT_SECONDS = 10.0  # time for a cancelled training to finish its step and write its scene when Blender quits
PATIENCE = 0.5  # seconds before a message is printed
_JOBS = ("RENDER", "OBJECT_BAKE")  # jobs of Blender that read the scene in their own threads

EventSource = Callable[[CancelToken], Iterator[Any]]
OnFinished = Callable[[Path], str | None]
"""Is called with a finished scene's file; returns an additional note for the panel, if any. May raise FrogError."""
Watcher = Callable[[TrainingState], None]
"""Is called with a training's state whenever it has changed, on Blender's main thread."""


class TrainingTask:
    """One training: ``start()`` it, ``pump()`` it until ``state.running`` is false.

    ``control`` pauses, resumes and cancels it at any time.

    Args:
        source: gives the events; called on the worker thread.
        on_finished: is given the file of a finished scene.
        is_scene_in_use: while true, ``on_finished`` has to wait.
    """

    def __init__(
        self,
        source: EventSource,
        on_finished: OnFinished | None = None,
        *,
        is_scene_in_use: Callable[[], bool] | None = None,
    ) -> None:
        self.state = TrainingState()
        self.on_finished = on_finished
        self._is_scene_in_use = is_scene_in_use or _is_scene_in_use
        self.waiting: Path | None = None  # a finished file that is not handed over yet
        self.control = CancelToken()
        self._source = source
        self._events: queue.Queue[Any] = queue.Queue()  # Any: events of the engine, which need torch to be imported
        # A daemon, because Python joins other threads before it runs atexit, which cancels this one.
        self._thread = threading.Thread(target=self.work, name="FRoG training", daemon=True)

    def start(self) -> TrainingTask:
        self._thread.start()
        return self

    def cancel(self) -> None:
        """Ask the worker to end, paused or not; it still writes what it has."""
        self.control.cancel()

    @property
    def paused(self) -> bool:
        """True while a running training is paused."""
        return self.state.running and self.control.paused

    def join(self, seconds: float = QUIT_SECONDS) -> bool:
        """Wait for the worker; true if it ended."""
        if self._thread.is_alive():
            self._thread.join(seconds)
        return not self._thread.is_alive()

    def work(self) -> None:
        """Runs on the worker thread: queues the source's events, and how it ended."""
        try:
            for event in self._source(self.control):
                self._events.put(event)
        except FrogError as error:
            self._events.put(Ended(str(error)))
        except BaseException as error:
            traceback.print_exc(file=sys.stderr)
            self._events.put(Ended(f"Training stopped on an unexpected {type(error).__name__}: {error}."))
        else:
            self._events.put(Ended(""))
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
                event = Ended("The training stopped without an error message. It may have run out of memory.")
            self.apply(event)
            if time.perf_counter() > deadline:
                return done + 1
        return most

    def _has_died(self) -> bool:
        """Whether the worker ended without its last message, which only happens when out of memory."""
        gone = self.state.running and self._thread.ident is not None and not self._thread.is_alive()
        return gone and self._events.empty()  # checked last: a message may have come just before the end

    def apply(self, event: Event | Ended) -> None:
        """Apply one event of the source, or the worker's last message, to ``state``."""
        state = self.state
        if not isinstance(event, Ended):
            try:
                state.take(event)
            except Exception as error:  # the events that follow can still be shown
                state.warnings.append(f"An event of the training cannot be shown ({brief(repr(error))}).")
            return
        state.error = state.error or event.error
        state.running = False
        if state.result and not state.error and not state.cancelled:
            self.waiting = state.result
            self.hand_over()

    def hand_over(self) -> None:
        """Calls ``on_finished`` with the file of a finished training once nothing else uses the scene."""
        if self.waiting is None or self._is_scene_in_use():
            return
        result, self.waiting = self.waiting, None
        try:
            if self.on_finished is not None:
                self.state.note = self.on_finished(result) or ""
        except FrogError as error:
            self.state.error = str(error)
        except Exception as error:  # would be lost otherwise, and the file exists
            traceback.print_exc(file=sys.stderr)
            self.state.error = f"{result}: the scene was trained, but could not be imported ({brief(repr(error))})."


def _is_scene_in_use() -> bool:
    """Whether a render or an operation works on a scene."""
    return any(map(bpy.app.is_job_running, _JOBS)) or unsaved_changes.is_being_changed()


@dataclass(frozen=True)
class Ended:
    """The worker's last message; an empty error means that it ended regularly."""

    error: str


class BackgroundTraining:
    """The current training and its watchers.

    Attributes:
        current: what the panel shows: the training that is running, or the last one that ran.
        watchers: callbacks for its state.
        patience: seconds before ``stop`` prints a message.
        quit_seconds: seconds that ``stop`` waits altogether.
    """

    def __init__(self, patience: float = PATIENCE, quit_seconds: float = QUIT_SECONDS) -> None:
        self.patience, self.quit_seconds = patience, quit_seconds
        self.current: TrainingTask | None = None
        self.watchers: list[Watcher] = []


def current() -> TrainingTask | None:
    """The training that the panel shows: running, or the last one that ran."""
    return addon_state.get(BackgroundTraining).current


def set_current(task: TrainingTask | None) -> None:
    """Sets the training that the panel shows; None for none."""
    addon_state.get(BackgroundTraining).current = task


def watch(watcher: Watcher) -> None:
    """Calls ``watcher`` with the current training's state whenever that has changed."""
    addon_state.get(BackgroundTraining).watchers.append(watcher)


def begin(source: EventSource, on_finished: OnFinished | None = None) -> TrainingTask:
    """Start a training as the current one, pumped by a timer; FrogError if one is running already."""
    last = current()
    if is_running():
        raise FrogError("A training is already running. Wait for it or cancel it first.")
    if last is not None and last.waiting:
        raise FrogError("The last scene is still waiting to be imported. Finish the current render or operation first.")
    task = TrainingTask(source, on_finished)
    try:
        task.start()
    except RuntimeError as error:  # no thread could be created
        raise FrogError(f"The training could not be started ({error}).") from error
    set_current(task)
    if not bpy.app.timers.is_registered(tick):
        bpy.app.timers.register(tick, first_interval=TIMER_SECONDS, persistent=True)
    return task


def is_running() -> bool:
    """Whether a training is running, paused or not."""
    task = current()
    return task is not None and task.state.running


def is_paused() -> bool:
    """Whether a training is running and paused."""
    task = current()
    return task is not None and task.paused


def is_computing() -> bool:
    """Whether a training is running and not paused."""
    return is_running() and not is_paused()


def stop() -> None:
    """Cancel the current training, give it QUIT_SECONDS to save, and drain its event queue."""
    state = addon_state.get(BackgroundTraining)
    task = state.current
    if task is None:
        return
    task.cancel()
    task.on_finished = None  # its result must not be imported into whatever comes next
    if not task.join(state.patience):
        has_learned = task.state.step > 0
        doing = "Saving what the training has learned" if has_learned else "Ending the training"
        _print(f"{doing}, which may take up to {state.quit_seconds:.0f} seconds.")
        if not task.join(state.quit_seconds - state.patience):
            _print("That took longer." + (" The last checkpoint is kept, if there is one." if has_learned else ""))
            return
    while task.pump():
        pass


def _print(sentence: str) -> None:
    print(f"FRoG: {sentence}", file=sys.stderr, flush=True)


def tick() -> float | None:
    """What Blender's timer calls: pumps the current training. Returns the seconds until the next call, None to end."""
    task = current()
    if task is None:
        return None
    try:
        if task.pump():
            for watcher in addon_state.get(BackgroundTraining).watchers:
                watcher(task.state)
            redrawing.sidebars()
        if task.state.running:
            unsaved_changes.count_as_unsaved()
    except Exception:  # Blender drops a timer that fails, and with it the rest of the training
        traceback.print_exc(file=sys.stderr)
        task.state.preview = None
    task.hand_over()
    return TIMER_SECONDS if task.state.running or task.waiting else None


def register() -> None:
    prefetch.share_cores(is_computing)
    atexit.register(stop)


def unregister() -> None:
    stop()
    set_current(None)
    atexit.unregister(stop)
    if bpy.app.timers.is_registered(tick):
        bpy.app.timers.unregister(tick)
