"""Training in the background. Its worker never touches Blender, so it goes on while another file is opened."""

from __future__ import annotations

import atexit
import sys
import traceback
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from .. import addon_state, redrawing, unsaved_changes
from ..engine import memory
from ..engine.errors import FrogError, brief
from ..engine.training.session.cancel_token import CancelToken
from ..timeline import open_scenes, prefetch
from .background_task import TIMER_SECONDS, BackgroundTask, begin_ticking, end_ticking
from .live_view import LiveView
from .training_state import TrainingState

if TYPE_CHECKING:
    from ..engine.training.session.events import Event

QUIT_SECONDS = 10.0  # time for a cancelled training to finish its step and write its scene when Blender quits
PATIENCE = 0.5  # seconds before a message is printed

EventSource = Callable[[CancelToken], Iterator[Any]]  # Any: events of the engine, which need torch to be imported
OnFinished = Callable[[Path], str | None]
"""Is called with a finished scene's file; returns an additional note for the panel, if any. May raise FrogError."""
Watcher = Callable[[TrainingState], None]
"""Is called with a training's state whenever it has changed, on Blender's main thread."""


@dataclass(frozen=True)
class Ended:
    """The worker's last message; an empty error means that it ended regularly."""

    error: str


class TrainingTask(BackgroundTask):
    """One training: ``start()`` it, ``pump()`` it until ``state.running`` is false.

    ``control`` pauses, resumes and cancels it at any time.

    Args:
        source: gives the events; called on the worker thread.
        on_finished: is given the file of a finished scene.
        prepare: does a part of ``on_finished`` before it, so that neither keeps the user waiting; at another time.
        is_scene_in_use: while true, ``on_finished`` has to wait.
        live: where viewports find its scene while it runs.
        kill: ends at once what the source has started outside Blender, where it did not end in time.
    """

    what = "training"
    quit_seconds = QUIT_SECONDS

    def __init__(
        self,
        source: EventSource,
        on_finished: OnFinished | None = None,
        *,
        prepare: Callable[[], None] | None = None,
        is_scene_in_use: Callable[[], bool] | None = None,
        live: LiveView | None = None,
        kill: Callable[[], None] = lambda: None,
    ) -> None:
        super().__init__()
        self.live, self.kill = live, kill
        self.state = TrainingState()
        self.on_finished, self.prepare = on_finished, prepare
        self._is_scene_in_use = is_scene_in_use or unsaved_changes.is_scene_in_use
        self.waiting: Path | None = None  # a finished file that is not handed over yet
        self.control = CancelToken()
        self._source = source

    @property
    def is_running(self) -> bool:
        return self.state.running

    def cancel(self) -> None:
        """Ask the worker to end, paused or not; it still writes what it has."""
        self.control.cancel()

    @property
    def paused(self) -> bool:
        """True while a running training is paused."""
        return self.state.running and self.control.paused

    def work(self) -> None:
        try:
            for event in self._source(self.control):
                self._open_result(event)
                self.put(event)
        except FrogError as error:
            self.put(Ended(str(error)))
        except BaseException as error:
            traceback.print_exc(file=sys.stderr)
            self.put(Ended(f"Training stopped on an unexpected {type(error).__name__}: {error}."))
        else:
            self.put(Ended(""))
        finally:
            memory.trim_heap()

    def _open_result(self, event: Event) -> None:
        """Reads a finished scene here, so that the main thread, which imports it, does not stand still for it."""
        from ..engine.training.session.events import Finished

        if self.on_finished is None or not isinstance(event, Finished):
            return
        with suppress(FrogError):  # which the import tells
            open_scenes.scene(Path(event.path)).at(0.0)

    def death(self) -> Ended:
        return Ended("The training stopped without an error message. It may have run out of memory.")

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
        """Calls ``on_finished`` with the file of a finished training once nothing else uses the scene; ``prepare``
        alone the first time, where there is any.
        """
        if self.waiting is None or self._is_scene_in_use():
            return
        if self.prepare is not None:
            prepare, self.prepare = self.prepare, None
            with suppress(Exception):  # which happens in ``on_finished`` as well, and is told then
                prepare()
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


class BackgroundTraining:
    """The current training and its watchers.

    Attributes:
        current: what the panel shows: the training that is running, or the last one that ran.
        watchers: callbacks for its state.
        live_watchers: callbacks for its scene.
        patience: seconds before ``stop`` prints a message.
        quit_seconds: seconds that ``stop`` waits altogether.
    """

    def __init__(self, patience: float = PATIENCE, quit_seconds: float = QUIT_SECONDS) -> None:
        self.patience, self.quit_seconds = patience, quit_seconds
        self.current: TrainingTask | None = None
        self.watchers: list[Watcher] = []
        self.live_watchers: list[Callable[[], None]] = []


def current() -> TrainingTask | None:
    """The training that the panel shows: running, or the last one that ran."""
    return addon_state.get(BackgroundTraining).current


def set_current(task: TrainingTask | None) -> None:
    """Sets the training that the panel shows; None for none."""
    state = addon_state.get(BackgroundTraining)
    before, state.current = state.current, task
    if before is not None and before is not task and before.live is not None:
        before.live.forget()
        _tell_live_watchers()


def watch(watcher: Watcher) -> None:
    """Calls ``watcher`` with the current training's state whenever that has changed."""
    addon_state.get(BackgroundTraining).watchers.append(watcher)


def watch_live(watcher: Callable[[], None]) -> None:
    """Calls ``watcher`` whenever there is another snapshot of the current training's scene, or none any more."""
    addon_state.get(BackgroundTraining).live_watchers.append(watcher)


def _tell_live_watchers() -> None:
    for watcher in addon_state.get(BackgroundTraining).live_watchers:
        watcher()


def begin(
    source: EventSource,
    on_finished: OnFinished | None = None,
    live: LiveView | None = None,
    prepare: Callable[[], None] | None = None,
    kill: Callable[[], None] = lambda: None,
) -> TrainingTask:
    """Start a training as the current one, pumped by a timer; FrogError if one is running already."""
    last = current()
    if is_running():
        raise FrogError("A training is already running. Wait for it or cancel it first.")
    if last is not None and last.waiting:
        raise FrogError("The last scene is still waiting to be imported. Finish the current render or operation first.")
    task = TrainingTask(source, on_finished, live=live, prepare=prepare, kill=kill).start()
    set_current(task)
    begin_ticking(tick)
    return task


def is_running() -> bool:
    """Whether a training is running, paused or not."""
    task = current()
    return task is not None and task.is_running


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
    task.on_finished = task.prepare = None  # its result must not be imported into whatever comes next
    if not task.join(state.patience):
        has_learned = task.state.step > 0
        doing = "Saving what the training has learned" if has_learned else "Ending the training"
        _print(f"{doing}, which may take up to {state.quit_seconds:.0f} seconds.")
        if not task.join(state.quit_seconds - state.patience):
            task.kill()
            _print("That took longer." + (" The last checkpoint is kept, if there is one." if has_learned else ""))
            return
    task.pump_all()


def _print(sentence: str) -> None:
    print(f"FRoG: {sentence}", file=sys.stderr, flush=True)


def tick() -> float | None:
    """What Blender's timer calls: pumps the current training. Returns the seconds until the next call, None to end."""
    task = current()
    if task is None:
        return None
    applied = 0
    try:
        if applied := task.pump():
            for watcher in addon_state.get(BackgroundTraining).watchers:
                watcher(task.state)
            redrawing.sidebars()
        if task.live is not None and task.live.update():
            _tell_live_watchers()
        if task.state.running:
            unsaved_changes.count_as_unsaved()
    except Exception:  # Blender drops a timer that fails, and with it the rest of the training
        traceback.print_exc(file=sys.stderr)
        task.state.preview = None
    if not applied:  # else that was enough at a time
        task.hand_over()
    return TIMER_SECONDS if task.state.running or task.waiting else None


def register() -> None:
    prefetch.share_cores(is_computing)
    atexit.register(stop)


def unregister() -> None:
    stop()
    set_current(None)
    atexit.unregister(stop)
    end_ticking(tick)
