"""Work beside Blender's main thread: a worker thread, a queue of its messages, and ``pump()`` on the main thread.

The worker never touches Blender. In a window a timer pumps what panels show; headless runs and tests, where timers do
not fire, call ``pump()`` in a loop.
"""

import atexit
import queue
import sys
import threading
import time
import traceback
from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any, ClassVar, Self, TypeAlias

from .. import addon_state, app_handlers, redrawing
from ..engine.errors import FrogError, brief, in_words
from ..engine.io.child_process import Stopped
from ..engine.whole_progress import Standing

PUMP_MESSAGES = 200  # the most messages one pump() applies
PUMP_SECONDS = 0.008  # and the longest it takes: half a frame at 60 Hz
TIMER_SECONDS = 0.1
REDRAW_SECONDS = 1.0  # between two redraws where nothing was told: the time that is left passes

# Any: each task has messages and a result of its own. A generic class would name them, but typing's caches keep its
# subclasses until Python has ended. Through them they keep the bpy module, and bpy 4.5 then waits in its own shutdown
# for ever.
Message: TypeAlias = Any


@dataclass(frozen=True)
class Progress:
    """What is being done, and how much of how much of it is.

    Attributes:
        whole: where all of the work is, if that is known.
        told_at: of ``time.monotonic``.
    """

    stage: str = "Starting"
    done: int = 0
    total: int = 0
    whole: Standing | None = None
    told_at: float = field(default_factory=lambda: time.monotonic(), compare=False)

    @property
    def fraction(self) -> float:
        """How much of the stage is done, 0 to 1."""
        return min(max(self.done / self.total, 0.0), 1.0) if self.total > 0 else 0.0


@dataclass(frozen=True)
class Ended:
    """The worker's last message: what it has made, or why it could not."""

    error: str = ""
    result: Any = None


class BackgroundTask(ABC):
    """One piece of work: ``begin()`` it for the panels, or ``start()`` it and ``pump()`` until it no longer runs.

    Only ``pump()`` writes what it shows, so that needs no lock.

    Attributes:
        progress: of the work.
        result: what a successful one has made; None until then.
        error: one sentence if it failed.
        is_running: whether the worker's last message was not applied yet.
        is_cancelled: it has ended because it was asked to.
        where: a path that begins its sentences, if not empty.
        slot: panels show one of each kind and slot.
    """

    what: ClassVar[str]
    """A noun for sentences, such as "training"."""
    busy: ClassVar[str]
    """What is said where one is running already."""
    quit_seconds: ClassVar[float] = 5.0
    """How long ``stop`` waits for the worker."""
    where = slot = ""
    note: Any = None
    """What ``on_finished`` returned."""
    on_finished: Callable[[Any], Any] | None = None
    """Is given the result on the main thread. May raise FrogError."""

    def __init__(self) -> None:
        self.progress = Progress()
        self.result: Any = None
        self.error = ""
        self.is_running, self.is_cancelled = True, False
        self._shown, self._drawn_at = 0.0, 0.0
        self.stopped = threading.Event()
        self._messages: queue.Queue[Message] = queue.Queue()
        # A daemon, because Python joins other threads before it runs atexit, which cancels this one.
        self._thread = threading.Thread(target=self._run, name=f"FRoG {self.what}", daemon=True)

    @abstractmethod
    def work(self) -> Any:
        """Runs on the worker thread; returns the result, or raises: FrogError, or Stopped where it was cancelled."""

    def take(self, message: Message) -> None:
        """Applies a message of the worker's own that is neither progress nor its end, on the main thread."""
        raise NotImplementedError(f"{message!r}: found a message that a {self.what} does not have.")

    @property
    def paused(self) -> bool:
        """Whether it waits for the user."""
        return False

    @property
    def standing(self) -> Standing:
        """What a bar shows of it now; the bar never goes back."""
        told = self.progress
        if told.whole is None:
            return Standing(told.stage, told.fraction, 0.0)
        now = told.whole if self.paused else told.whole.after(time.monotonic() - told.told_at)
        self._shown = max(self._shown, now.fraction)
        return replace(now, fraction=self._shown)

    @property
    def kept_at_quit(self) -> str:
        """What is left of it if Blender quits now, as a sentence."""
        return "What it has done so far is lost."

    def redraw(self) -> None:
        """Redraws what shows it."""
        self._drawn_at = time.monotonic()
        redrawing.status_bars()
        if self.is_running:
            redrawing.sidebars()
        else:
            redrawing.viewports()  # what was made may be drawn there

    @classmethod
    def current(cls, slot: str = "") -> Self | None:
        """The one that panels show: running, or the last one that ran."""
        return addon_state.get(_Shown).tasks.get((cls.what, slot))

    @classmethod
    def is_any_running(cls, slot: str = "") -> bool:
        """Whether one that panels show is running."""
        task = cls.current(slot)
        return task is not None and task.is_running

    @classmethod
    def forget(cls, slot: str = "") -> None:
        """Panels show none any more."""
        addon_state.get(_Shown).tasks.pop((cls.what, slot), None)

    def begin(self) -> Self:
        """Starts it as the one that panels show; FrogError if one is running, and as of ``start``."""
        last = self.current(self.slot)
        if last is not None and last.is_running:
            raise FrogError(self.busy)
        return self.start().show()

    def show(self) -> Self:
        """Panels show it, and a timer pumps it, in whatever file is open."""
        addon_state.get(_Shown).tasks[self.what, self.slot] = self
        app_handlers.later(tick, TIMER_SECONDS, persistent=True)
        return self

    def start(self) -> Self:
        """Starts the worker; FrogError if no thread can be created."""
        with in_words(f"The {self.what} could not be started", kinds=RuntimeError):
            self._thread.start()
        return self

    def cancel(self) -> None:
        """Asks the worker to end."""
        self.stopped.set()

    @property
    def is_stopping(self) -> bool:
        """True from ``cancel()`` to the end."""
        return self.is_running and self.stopped.is_set()

    def put(self, message: Message) -> None:
        """Queues a message; called on the worker thread."""
        self._messages.put(message)

    def tell_whole(self, standing: Standing) -> None:
        """Queues where the whole work is; called on the worker thread."""
        self.put(Progress(standing.stage, whole=standing))

    def tell(self, stage: str, done: int = 0, total: int = 0) -> None:
        """Queues progress; called on the worker thread."""
        self.put(Progress(stage, done, total))

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
                message = Ended(error=self.sentence("stopped without an error message; the memory may be full"))
            self.apply(message)
            if time.perf_counter() > deadline:
                return done + 1
        return most

    def pump_all(self) -> None:
        """Applies all waiting messages."""
        while self.pump():
            pass

    def tick(self) -> bool:
        """Is called by the timer; whether to call it again."""
        if self.pump() or self.is_redraw_due:
            self.redraw()
        return self.is_running

    @property
    def is_redraw_due(self) -> bool:
        """Whether what shows it is to be redrawn though nothing was told."""
        return self.is_running and time.monotonic() - self._drawn_at > REDRAW_SECONDS

    def stop(self) -> None:
        """Cancels it, so that it hands nothing over any more, and waits for it to end."""
        self.cancel()
        self.on_finished = None
        if self.join():
            self.pump_all()

    def apply(self, message: Message) -> None:
        """Applies a message of the worker."""
        if isinstance(message, Progress):
            self.progress = message
        elif isinstance(message, Ended):
            self.conclude(message)
            self.is_running = False
            if self.result is not None and not self.error and not self.is_cancelled:
                self.hand_over()
        else:
            self.take(message)

    def conclude(self, ended: Ended) -> None:
        """Keeps how it ended. Whatever ends one that was cancelled is no error, and what it made in time counts."""
        self.result, self.error = ended.result, ended.error
        if self.stopped.is_set() and self.result is None:
            self.is_cancelled, self.error = True, ""

    def hand_over(self) -> None:
        """Calls ``on_finished``; what that raises becomes the error."""
        try:
            if self.on_finished is not None:
                self.note = self.on_finished(self.result)
        except FrogError as error:
            self.error = str(error)
        except Exception as error:  # would be lost otherwise, and the result exists
            traceback.print_exc(file=sys.stderr)
            self.error = f"{self.made()}: written, but it could not be opened ({brief(repr(error))})."

    def made(self) -> object:
        """The file or folder that it has made."""
        return self.result

    def sentence(self, verb: str) -> str:
        """One about this task."""
        return f"{self.where}: the {self.what} {verb}." if self.where else f"The {self.what} {verb}."

    def _run(self) -> None:
        try:
            ended = Ended(result=self.work())
        except FrogError as error:
            ended = Ended(error=str(error))
        except Stopped:
            ended = Ended()
        except BaseException as error:
            traceback.print_exc(file=sys.stderr)
            why = "ran out of memory" if isinstance(error, MemoryError) else ""
            why = why or f"stopped on an unexpected {type(error).__name__} ({brief(error)})"
            ended = Ended(error=self.sentence(why))
        self.put(ended)

    def _has_died(self) -> bool:
        """Whether the worker ended without its last message, which only happens when out of memory."""
        gone = self.is_running and self._thread.ident is not None and not self._thread.is_alive()
        return gone and self._messages.empty()  # checked last: a message may have come just before the end


class _Shown:
    """The tasks that panels show, by kind and slot."""

    def __init__(self) -> None:
        self.tasks: dict[tuple[str, str], Any] = {}  # Any: of the kind that the key names


def running() -> list[BackgroundTask]:
    """Those that panels show and that run."""
    return [task for task in addon_state.get(_Shown).tasks.values() if task.is_running]


def at_quitting() -> list[str]:
    """What runs, and what is kept of it if Blender quits now: sentences about each."""
    return [f"The {task.what} is not done yet. {task.kept_at_quit}" for task in running()]


def tick() -> float | None:
    """What Blender's timer calls: pumps what panels show. Returns the seconds until the next call, None to end."""
    goes_on = False
    for task in list(addon_state.get(_Shown).tasks.values()):
        try:
            goes_on |= task.tick()
        except Exception:  # Blender drops a timer that fails, and with it the rest of the work
            traceback.print_exc(file=sys.stderr)
    return TIMER_SECONDS if goes_on or running() else None  # one may have begun another


def stop() -> None:
    """Cancels all that panels show, and waits for it to end."""
    tasks = list(addon_state.get(_Shown).tasks.values())
    for task in tasks:
        task.cancel()
    for task in tasks:
        task.stop()


def register() -> None:
    atexit.register(stop)


def unregister() -> None:
    stop()
    for task in list(addon_state.get(_Shown).tasks.values()):
        task.forget(task.slot)
    atexit.unregister(stop)
    app_handlers.not_later(tick)
