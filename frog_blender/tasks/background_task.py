"""Work beside Blender's main thread: a worker thread, a queue of its messages, and ``pump()`` on the main thread.

The worker never touches Blender. In a window a timer pumps; headless runs and tests, where timers do not fire, call
``pump()`` in a loop.
"""

from __future__ import annotations

import queue
import threading
import time
from abc import ABC, abstractmethod
from collections.abc import Callable
from typing import Any, ClassVar, Self, TypeAlias

import bpy

from .. import redrawing
from ..engine.errors import FrogError

PUMP_MESSAGES = 200  # the most messages one pump() applies
PUMP_SECONDS = 0.008  # and the longest it takes: half a frame at 60 Hz
TIMER_SECONDS = 0.1

# Any: each task has messages of its own. A generic class would name them, but typing's caches keep its subclasses until
# Python has ended. Through them they keep the bpy module, and bpy 4.5 then waits in its own shutdown for ever.
Message: TypeAlias = Any


class BackgroundTask(ABC):
    """One piece of work: ``start()`` it, ``pump()`` it until ``is_running`` is false."""

    what: ClassVar[str]
    """A noun for sentences, such as "training"."""
    quit_seconds: ClassVar[float]
    """How long ``join`` waits unless told."""
    on_finished: Callable[..., Any] | None = None
    """Is given what a successful one has made, as each kind says."""

    def __init__(self) -> None:
        self._messages: queue.Queue[Message] = queue.Queue()
        # A daemon, because Python joins other threads before it runs atexit, which cancels this one.
        self._thread = threading.Thread(target=self.work, name=f"FRoG {self.what}", daemon=True)

    @property
    @abstractmethod
    def is_running(self) -> bool:
        """Whether the worker's last message was not applied yet."""

    @abstractmethod
    def work(self) -> None:
        """Runs on the worker thread: ``put()``s its messages, and at last how it ended."""

    @abstractmethod
    def apply(self, message: Message) -> None:
        """Applies a message of the worker; called on the main thread."""

    @abstractmethod
    def death(self) -> Message:
        """The last message of a worker that ended without one."""

    @abstractmethod
    def cancel(self) -> None:
        """Asks the worker to end."""

    def start(self) -> Self:
        """Starts the worker; FrogError if no thread can be created."""
        try:
            self._thread.start()
        except RuntimeError as error:
            raise FrogError(f"The {self.what} could not be started ({error}).") from error
        return self

    def put(self, message: Message) -> None:
        """Queues a message; called on the worker thread."""
        self._messages.put(message)

    def join(self, seconds: float | None = None) -> bool:
        """Waits for the worker; true if it ended."""
        if self._thread.is_alive():
            self._thread.join(self.quit_seconds if seconds is None else seconds)
        return not self._thread.is_alive()

    def pump(self, most: int = PUMP_MESSAGES) -> int:
        """Applies waiting messages: at most ``most``, for at most about PUMP_SECONDS. Returns how many. Never waits."""
        deadline = time.perf_counter() + PUMP_SECONDS
        for done in range(most):
            try:
                message = self._messages.get_nowait()
            except queue.Empty:
                if not self._has_died():
                    return done
                message = self.death()
            self.apply(message)
            if time.perf_counter() > deadline:
                return done + 1
        return most

    def pump_all(self) -> None:
        """Applies all waiting messages."""
        while self.pump():
            pass

    def _has_died(self) -> bool:
        """Whether the worker ended without its last message, which only happens when out of memory."""
        gone = self.is_running and self._thread.ident is not None and not self._thread.is_alive()
        return gone and self._messages.empty()  # checked last: a message may have come just before the end


Tick = Callable[[], float | None]
"""What Blender's timer calls: returns the seconds until the next call, None to end."""


def begin_ticking(tick: Tick) -> None:
    """Lets Blender's timer call ``tick``, in whatever file is open."""
    if not bpy.app.timers.is_registered(tick):
        bpy.app.timers.register(tick, first_interval=TIMER_SECONDS, persistent=True)


def end_ticking(tick: Tick) -> None:
    """Ends that."""
    if bpy.app.timers.is_registered(tick):
        bpy.app.timers.unregister(tick)


class TaskHolder:
    """The task of one kind that a panel shows: running, or the last one that ran.

    A subclass for each kind, of which ``addon_state`` keeps the object; its module has the ``tick`` that a timer calls.
    """

    busy: ClassVar[str]
    """What is said where one is running already."""
    task: BackgroundTask | None = None

    @property
    def is_running(self) -> bool:
        """Whether one is running."""
        return self.task is not None and self.task.is_running

    def begin(self, create: Callable[[], BackgroundTask], tick: Tick) -> None:
        """Creates and starts a task, pumped by a timer; FrogError if one is running, and as creating it raises."""
        if self.is_running:
            raise FrogError(self.busy)
        self.task = create().start()
        begin_ticking(tick)

    def tick(self) -> float | None:
        """Pumps the task. Returns the seconds until the next time, None to end."""
        if self.task is None:
            return None
        if self.task.pump():
            redrawing.sidebars()
        if self.task.is_running:
            return TIMER_SECONDS
        self.on_end()
        return None

    def on_end(self) -> None:
        """Is called once the task has ended, on the main thread."""

    def stop(self) -> None:
        """Cancels the task, which hands nothing over any more, and waits for it to end."""
        if self.task is None:
            return
        self.task.cancel()
        self.task.on_finished = None
        if self.task.join():
            self.task.pump_all()
