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

from .. import addon_state
from ..engine import memory
from ..engine.errors import FrogError, brief
from ..engine.training.session.cancel_token import CancelToken
from ..timeline import prefetch
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
Watcher = Callable[[TrainingState], None]
"""Is told of a training's state whenever that has changed, on Blender's main thread."""


class TrainingTask:
    """One training: ``start()`` it, ``pump()`` it until ``state.running`` is false.

    ``control`` pauses, resumes and cancels it at any time.
    """

    def __init__(self, source: EventSource, on_finished: OnFinished | None = None) -> None:
        self.state = TrainingState()
        self.on_finished = on_finished
        self.waiting: Path | None = None  # a finished file that is to be handed over
        self.control = CancelToken()
        self._source = source
        self._events: queue.Queue[Any] = queue.Queue()  # Any: events of the engine, which need torch to be imported
        # A daemon, because Python waits for other threads before it runs atexit, where this one is asked to end.
        self._thread = threading.Thread(target=self.work, name="FRoG training", daemon=True)

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

    def work(self) -> None:
        """What the worker thread does: it goes through the source and queues what that says, how it ends included."""
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
                event = Ended("The training stopped without giving a reason, possibly out of memory.")
            self.apply(event)
            if time.perf_counter() > deadline:
                return done + 1
        return most

    def _has_died(self) -> bool:
        """Whether the worker is gone and its last message, which only a lack of memory can swallow, never came."""
        gone = self.state.running and self._thread.ident is not None and not self._thread.is_alive()
        return gone and self._events.empty()  # asked last: it may have spoken just before it ended

    def apply(self, event: Any) -> None:
        """Take one event of the source's, or the worker's last message, into ``state``."""
        state = self.state
        if not isinstance(event, Ended):
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
            if self.on_finished is not None:
                self.state.note = self.on_finished(result) or ""
        except FrogError as error:
            self.state.error = str(error)
        except Exception as error:  # nobody else would hear of it, and the file is there
            traceback.print_exc(file=sys.stderr)
            self.state.error = f"{result}: it is trained, but could not be imported ({brief(repr(error))})."


@dataclass(frozen=True)
class Ended:
    """The worker's last message; an empty error means that it came to its own end."""

    error: str


class BackgroundTraining:
    """The training of this Blender.

    Attributes:
        current: what the panel shows: the training that is running, or the last one that ran.
        watchers: who is told of its state.
    """

    def __init__(self) -> None:
        self.current: TrainingTask | None = None
        self.watchers: list[Watcher] = []


def current() -> TrainingTask | None:
    """The training that the panel shows: running, or the last one that ran."""
    return addon_state.get(BackgroundTraining).current


def set_current(task: TrainingTask | None) -> None:
    """Makes a training the one that the panel shows; None for none."""
    addon_state.get(BackgroundTraining).current = task


def watch(watcher: Watcher) -> None:
    """Has ``watcher`` told of the current training's state whenever that has changed."""
    addon_state.get(BackgroundTraining).watchers.append(watcher)


def begin(source: EventSource, on_finished: OnFinished | None = None) -> TrainingTask:
    """Start a training as the current one, pumped by a timer; FrogError if one is running already."""
    last = current()
    if is_running():
        raise FrogError("A training is running already; wait for it or cancel it first.")
    if last is not None and last.waiting:
        raise FrogError("The last scene is still waiting to be imported; finish the current render or operation first.")
    task = TrainingTask(source, on_finished)
    try:
        task.start()
    except RuntimeError as error:  # the system has no thread left
        raise FrogError(f"The training could not be started ({error}).") from error
    set_current(task)
    if not bpy.app.timers.is_registered(tick):
        bpy.app.timers.register(tick, first_interval=TIMER_SECONDS, persistent=True)
    return task


def is_running() -> bool:
    """Whether a training is under way, paused or not."""
    task = current()
    return task is not None and task.state.running


def is_paused() -> bool:
    """Whether a training is under way and held."""
    task = current()
    return task is not None and task.paused


def is_computing() -> bool:
    """Whether a training is under way and not held."""
    return is_running() and not is_paused()


def stop() -> None:
    """Cancel the current training, give it QUIT_SECONDS to save, and drain its event queue."""
    task = current()
    if task is None:
        return
    task.cancel()
    task.on_finished = None  # whoever stops a training does not want its result imported into what comes next
    if not task.join(PATIENCE):
        has_learned = task.state.step > 0
        doing = "Saving what the training has learned" if has_learned else "Ending the training"
        _print(f"{doing}, which may take up to {QUIT_SECONDS:.0f} seconds.")
        if not task.join(QUIT_SECONDS - PATIENCE):
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
            _redraw()
        if task.state.running:
            unsaved_changes.count_as_unsaved()
    except Exception:  # Blender drops a timer that fails, and with it the rest of the training
        traceback.print_exc(file=sys.stderr)
        task.state.preview = None
    task.hand_over()
    return TIMER_SECONDS if task.state.running or task.waiting else None


def _redraw() -> None:
    for window in bpy.context.window_manager.windows:
        for area in window.screen.areas:
            if area.type == "VIEW_3D":
                for region in area.regions:  # the sidebar alone: drawing the view again would cost the window more
                    if region.type == "UI":
                        region.tag_redraw()


def register() -> None:
    prefetch.share_cores(is_computing)
    atexit.register(stop)


def unregister() -> None:
    stop()
    set_current(None)
    atexit.unregister(stop)
    if bpy.app.timers.is_registered(tick):
        bpy.app.timers.unregister(tick)
