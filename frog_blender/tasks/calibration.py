"""Calibration in the background. What may crash runs in processes that the worker starts."""

from __future__ import annotations

import atexit
import sys
import threading
import traceback
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from .. import addon_state, redrawing
from ..engine.errors import FrogError, brief
from .background_task import BackgroundTask, TaskHolder, end_ticking
from .calibration_request import Calibrator
from .calibration_state import CalibrationState

if TYPE_CHECKING:
    from ..engine.capture.calibration.pipeline import Outcome

OnFinished = Callable[[Path, "Outcome"], None]
"""Is called on the main thread with the folder and what was written. May raise FrogError."""


@dataclass(frozen=True)
class _Told:
    """Progress."""

    stage: str
    done: int
    total: int


@dataclass(frozen=True)
class _Ended:
    """The worker's last message."""

    outcome: Outcome | None = None
    error: str = ""
    is_refused: bool = False


class CalibrationTask(BackgroundTask):
    """One calibration: ``start()`` it, ``pump()`` it until ``state.running`` is false.

    Args:
        folder: of the videos.
        calibrator: does the work; called on the worker thread.
        on_finished: is given what a successful one wrote.
    """

    what = "calibration"
    quit_seconds = 5.0  # for a cancelled calibration to end its processes when Blender quits

    def __init__(self, folder: Path, calibrator: Calibrator, on_finished: OnFinished | None = None) -> None:
        super().__init__()
        self.state = CalibrationState(folder)
        self.on_finished = on_finished
        self._calibrator = calibrator
        self._stop = threading.Event()

    @property
    def is_running(self) -> bool:
        return self.state.running

    def cancel(self) -> None:
        """Asks the worker to end. Stages that are done are kept for the next time."""
        self._stop.set()

    @property
    def is_stopping(self) -> bool:
        """True from ``cancel()`` to the end."""
        return self.state.running and self._stop.is_set()

    def work(self) -> None:
        from ..engine.capture.calibration.calibration import CalibrationRefused

        try:
            outcome = self._calibrator(self._tell, self._stop.is_set)
        except CalibrationRefused as refused:
            self.put(_Ended(error=str(refused), is_refused=True))
        except FrogError as error:
            self.put(_Ended(error=str(error)))
        except BaseException as error:
            if self._stop.is_set():  # each part has an exception of its own for this
                self.put(_Ended())
                return
            traceback.print_exc(file=sys.stderr)
            reason = f"Calibration stopped on an unexpected {type(error).__name__}: {brief(error)}."
            self.put(_Ended(error=reason))
        else:
            self.put(_Ended(outcome))

    def _tell(self, stage: str, done: int, total: int) -> None:
        self.put(_Told(stage, done, total))

    def death(self) -> _Ended:
        return _Ended(error="The calibration stopped without an error message.")

    def apply(self, message: _Told | _Ended) -> None:
        state = self.state
        if isinstance(message, _Told):
            state.stage, state.done, state.total = message.stage, message.done, message.total
            return
        state.running = False
        state.error, state.is_refused, state.outcome = message.error, message.is_refused, message.outcome
        state.cancelled = self._stop.is_set() and state.outcome is None
        if state.cancelled:
            state.error, state.is_refused = "", False
        if state.outcome is not None and self.on_finished is not None:
            self._hand_over(state.outcome, self.on_finished)

    def _hand_over(self, outcome: Outcome, on_finished: OnFinished) -> None:
        try:
            on_finished(self.state.folder, outcome)
        except FrogError as error:
            self.state.error = str(error)
        except Exception as error:  # would be lost otherwise, and the result exists
            traceback.print_exc(file=sys.stderr)
            self.state.error = f"{outcome.cameras}: written, but the capture could not be opened ({brief(error)})."


class CurrentCalibration(TaskHolder):
    """The calibration that the panel shows: running, or the last one that ran."""

    busy = "A calibration is already running. Wait for it or cancel it first."
    task: CalibrationTask | None = None

    def on_end(self) -> None:
        redrawing.viewports()  # the rig is drawn there


def current() -> CalibrationTask | None:
    """The calibration that the panel shows: running, or the last one that ran."""
    return addon_state.get(CurrentCalibration).task


def set_current(task: CalibrationTask | None) -> None:
    """Sets the calibration that the panel shows; None for none."""
    addon_state.get(CurrentCalibration).task = task


def is_running() -> bool:
    """Whether a calibration is running."""
    return addon_state.get(CurrentCalibration).is_running


def begin(folder: Path, calibrator: Calibrator, on_finished: OnFinished | None = None) -> CalibrationTask:
    """Starts a calibration as the current one, pumped by a timer; FrogError if one is running already."""
    holder = addon_state.get(CurrentCalibration)
    holder.begin(lambda: CalibrationTask(folder, calibrator, on_finished), tick)
    assert holder.task is not None
    return holder.task


def tick() -> float | None:
    """What Blender's timer calls: pumps the current calibration. Returns the seconds until the next call, or None."""
    return addon_state.get(CurrentCalibration).tick()


def stop() -> None:
    """Cancels the current calibration and waits for it to end its processes."""
    addon_state.get(CurrentCalibration).stop()


def register() -> None:
    atexit.register(stop)


def unregister() -> None:
    stop()
    set_current(None)
    atexit.unregister(stop)
    end_ticking(tick)
