"""Operators with many steps: one at a time in a window, where Esc stops them; otherwise all at once."""

import math
import sys
import time
import traceback
from collections.abc import Generator
from typing import Any, TypeAlias

import bpy

from .. import redrawing
from ..engine.errors import FrogError
from ..tasks.background_task import BackgroundTask
from .bases import FrogOperator

Steps: TypeAlias = Generator[int, None, None]
"""Yields the number of steps done."""
_WAIT = 0.01  # seconds that the main thread waits for a worker, where nobody works meanwhile


class ModalOperator(FrogOperator):
    """A base next to ``bpy.types.Operator``: ``begin`` says which steps there are.

    An exception of a step ends the operator with a message. Between two steps anything may happen to the file, so a
    step must not keep references to its objects.
    """

    doing = "Working: {done:,} of {total:,}"
    """Text of the status bar."""
    said = stopped = ""
    """The reports when all steps are done, and when the user stopped the operator."""
    stop_keys: tuple[str, ...] = ("ESC", "RIGHTMOUSE")
    at_once = 0.0
    """Seconds of work before the user goes on."""
    slice_seconds = 0.0
    """Seconds of work between two checks of the keyboard, at least one step."""
    timer_seconds = 0.01
    """Between two steps in a window, or groups of steps."""
    is_interactive = False
    """Whether a user asked for it, not a script: several steps are then done while Blender stays responsive."""
    has_changed_file = False
    """Set by a step after which the operator ends as finished, whatever ends it: so there is an undo step for it."""

    _steps: Steps | None = None
    timer: Any = None  # Any: of Blender; None while no window waits for the next step
    _done = 0
    _total = 0
    _workspaces: frozenset[int] = frozenset()  # session_uids of those that show a text

    def begin(self, context: bpy.types.Context) -> tuple[Steps, int]:
        """The steps, and how many there are; FrogError where nothing can be begun."""
        raise NotImplementedError

    def execute(self, context: bpy.types.Context) -> set[str]:
        """Runs the steps: one by one in a window if a user asked for them, or all of them now."""
        try:
            steps, total = self.begin(context)
        except FrogError as error:
            return self.failed(error)
        in_steps, self.is_interactive = self.is_interactive, False  # a repeated operator runs to its end
        return self.run(context, steps, total, in_window=in_steps and total > 1 and self.has_window(context))

    @staticmethod
    def has_window(context: bpy.types.Context) -> bool:
        """Whether there is a window to show progress in, whose timers fire."""
        return context.window is not None and not bpy.app.background

    def run(self, context: bpy.types.Context, steps: Steps, total: int, *, in_window: bool) -> set[str]:
        """Runs all steps now; in a window those that ``at_once`` suffices for, and the others from a timer."""
        self._steps, self._done, self._total, self.has_changed_file = steps, 0, total, False
        deadline = time.perf_counter() + (self.at_once if in_window else math.inf)
        while time.perf_counter() < deadline:
            if ended := self._step(context):
                return ended
        manager = context.window_manager
        self.timer = manager.event_timer_add(self.timer_seconds, window=context.window)
        manager.modal_handler_add(self)
        self._show_progress(context)
        return {"RUNNING_MODAL"}

    def modal(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        if self._steps is None:
            return {"CANCELLED"}
        if event.type in self.stop_keys and event.value == "PRESS":
            return self.end(context, "INFO", self.stopped_message(), self._unfinished())
        # A render changes frames in its own thread; nothing else may do so meanwhile.
        if event.type != "TIMER" or bpy.app.is_job_running("RENDER"):
            return {"PASS_THROUGH"}
        deadline = time.perf_counter() + self.slice_seconds
        while not (ended := self._step(context)):
            if time.perf_counter() >= deadline:
                return {"PASS_THROUGH"}
        return ended

    def cancel(self, context: bpy.types.Context) -> None:
        """Called by Blender when the window or the file is closed. The file's data must not be touched any more."""
        self._clean_up(context)

    def finished_message(self) -> str:
        """The report when all steps are done; empty for none."""
        return self.said

    def stopped_message(self) -> str:
        """The report when the user stopped the operator."""
        return self.stopped

    def failed_message(self, reason: str) -> str:
        """The report when a step failed; ``reason`` is a sentence."""
        return reason

    def restore(self) -> None:
        """Restore what the steps changed; not called when the file is closed."""

    def _step(self, context: bpy.types.Context) -> set[str]:
        """Runs one step; the empty set while there are more."""
        assert self._steps is not None
        try:
            done = next(self._steps, None)
        except Exception as error:
            reason = str(error)
            if not isinstance(error, FrogError):
                traceback.print_exc(file=sys.stderr)
                reason = f"Stopped on an unexpected {type(error).__name__}: {error}."
            return self.end(context, "ERROR", self.failed_message(reason), self._unfinished())
        if done is None:
            return self.end(context, "INFO", self.finished_message(), {"FINISHED"})
        self._done = done
        self._show_progress(context)
        return set()

    def _show_progress(self, context: bpy.types.Context) -> None:
        if self.timer is not None and context.workspace is not None:
            doing = self.doing.format(done=self._done, total=self._total)
            keys = "Esc, Right Mouse" if len(self.stop_keys) > 1 else "Esc"
            context.workspace.status_text_set(f"{doing} | {keys}: Stop")
            self._workspaces |= {context.workspace.session_uid}

    def _unfinished(self) -> set[str]:
        return {"FINISHED"} if self.has_changed_file else {"CANCELLED"}

    def end(self, context: bpy.types.Context, kind: str, sentence: str, result: set[str]) -> set[str]:
        """Cleans up, reports and gives Blender the result."""
        self._clean_up(context)
        self.restore()
        if sentence:
            self.report({kind}, sentence)
        return result

    def _clean_up(self, context: bpy.types.Context) -> None:
        """Ends the steps, the progress and the timer. May be called twice."""
        if self._steps is None:
            return
        self._steps.close()
        self._steps = None
        if self.timer is not None:
            context.window_manager.event_timer_remove(self.timer)
            self.timer = None
        with redrawing.some_window():
            for workspace in bpy.data.workspaces:  # the user may have gone from one to another
                if workspace.session_uid in self._workspaces:
                    workspace.status_text_set(None)
        self._workspaces = frozenset()


class BesideUser(ModalOperator):
    """A base of those that a worker thread does: in a window the user goes on meanwhile, and Esc stops it."""

    stop_keys = ("ESC",)
    timer_seconds = 0.1

    @property
    def is_waiting(self) -> bool:
        """Whether it has changed nothing in the file yet."""
        return not self.has_changed_file

    def pump(self, task: BackgroundTask) -> None:
        """Applies what a worker has told; waits for it a moment where there is no window."""
        if self.timer is None:
            task.join(_WAIT)
        task.pump()
