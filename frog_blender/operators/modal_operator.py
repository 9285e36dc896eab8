"""Operators of many steps: in a window a step at a time, while Blender goes on and Esc stops them; else all at once."""

from __future__ import annotations

import sys
import time
import traceback
from collections.abc import Generator
from typing import Any

import bpy

from ..engine.errors import FrogError

_TIMER_SECONDS = 0.01


def has_window(context: Any) -> bool:
    """Somebody is there to whom progress can be shown, and whose timers fire."""
    return context.window is not None and not bpy.app.background


class ModalOperator:
    """A base beside ``bpy.types.Operator``; ``execute`` ends with ``go_through`` or ``go_on_in_window``.

    The steps are a generator that yields how many of the total are done, after each, and ends. Whatever a step raises
    ends the operator with a sentence. A step must not rely on objects of the file: anything may happen to them between
    two.
    """

    doing = "Working: {done:,} of {total:,}"
    """What the status bar says."""
    slice_seconds = 0.0
    """Of work between two looks at the keyboard, one step at least."""

    _steps: Generator[int, None, None] | None = None
    timer: Any = None  # Any: of Blender; None while no window waits for the next step
    _done = 0
    _total = 0

    def go_through(self, context: Any, steps: Generator[int, None, None], total: int) -> set[str]:
        """All steps now."""
        self._begin(context, steps, total)
        try:
            while not (ended := self._step(context)):
                pass
        finally:
            self._clean_up(context)
        return ended

    def go_on_in_window(self, context: Any, steps: Generator[int, None, None], total: int) -> set[str]:
        """A step whenever a timer fires, from now on."""
        self._begin(context, steps, total)
        manager = context.window_manager
        self.timer = manager.event_timer_add(_TIMER_SECONDS, window=context.window)
        manager.modal_handler_add(self)
        self._say(context)
        return {"RUNNING_MODAL"}

    def modal(self, context: Any, event: Any) -> set[str]:
        if self._steps is None:
            return {"CANCELLED"}
        if event.type in ("ESC", "RIGHTMOUSE") and event.value == "PRESS":
            return self.end(context, "INFO", self.stopped_sentence(), {"CANCELLED"})
        # A render evaluates the file in its own thread; nothing else may go through the frames meanwhile.
        if event.type != "TIMER" or bpy.app.is_job_running("RENDER"):
            return {"PASS_THROUGH"}
        deadline = time.perf_counter() + self.slice_seconds
        while not (ended := self._step(context)):
            if time.perf_counter() >= deadline:
                return {"PASS_THROUGH"}
        return ended

    def cancel(self, context: Any) -> None:
        """Called by Blender, when the window or the file is closed; what is there is not to be touched any more."""
        self._clean_up(context)

    def finished_sentence(self) -> str:
        """What is reported at the end."""
        raise NotImplementedError

    def stopped_sentence(self) -> str:
        """What is reported when a user stopped it."""
        raise NotImplementedError

    def failed_sentence(self, reason: str) -> str:
        """What is reported when a step went wrong; ``reason`` is a sentence."""
        return reason

    def restore(self) -> None:
        """Put back what the steps changed; not called when the file is closed."""

    def _begin(self, context: Any, steps: Generator[int, None, None], total: int) -> None:
        self._steps, self._done, self._total = steps, 0, total
        context.window_manager.progress_begin(0, total)

    def _step(self, context: Any) -> set[str]:
        """One step; the empty set while there are more."""
        assert self._steps is not None
        try:
            done = next(self._steps, None)
        except FrogError as error:
            return self.end(context, "ERROR", self.failed_sentence(str(error)), {"CANCELLED"})
        except Exception as error:
            traceback.print_exc(file=sys.stderr)
            reason = f"Stopped on an unexpected {type(error).__name__}: {error}."
            return self.end(context, "ERROR", self.failed_sentence(reason), {"CANCELLED"})
        if done is None:
            return self.end(context, "INFO", self.finished_sentence(), {"FINISHED"})
        self._done = done
        self._say(context)
        return set()

    def _say(self, context: Any) -> None:
        context.window_manager.progress_update(self._done)
        if self.timer is not None and context.workspace is not None:
            doing = self.doing.format(done=self._done, total=self._total)
            context.workspace.status_text_set(f"{doing} | Esc, Right Mouse: Stop")

    def end(self, context: Any, kind: str, sentence: str, result: set[str]) -> set[str]:
        """Cleans up, reports and gives Blender the result."""
        self._clean_up(context)
        self.restore()
        self.report({kind}, sentence)  # type: ignore[attr-defined]
        return result

    def _clean_up(self, context: Any) -> None:
        """Once is enough, twice does no harm."""
        if self._steps is None:
            return
        self._steps.close()
        self._steps = None
        context.window_manager.progress_end()
        if self.timer is not None:
            context.window_manager.event_timer_remove(self.timer)
            self.timer = None
            if context.workspace is not None:
                context.workspace.status_text_set(None)
