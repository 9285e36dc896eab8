"""Calibration in the background. What may crash runs in processes that the worker starts."""

from contextlib import suppress
from pathlib import Path

from ..engine.capture.calibration import pipeline
from ..engine.capture.calibration.pipeline import Options, Outcome
from ..engine.capture.readers import detect, near_layouts
from ..engine.capture.synchronization.films import CalibrationRefused
from ..engine.errors import FrogError
from .background_task import BackgroundTask


class CalibrationTask(BackgroundTask):
    """One calibration; its result is an ``Outcome``. Stages that are done are kept when it is cancelled.

    Args:
        folder: with a video of each camera, or one moving camera's.
        layout, in_step: what is known of the footage, as of ``Options``.
    """

    what = "calibration"
    busy = "A calibration is already running. Wait for it or cancel it first."
    is_refused = False
    """Whether it failed because the footage does not fix its cameras; the error says what to film next time."""

    def __init__(self, folder: Path, layout: str = "auto", *, in_step: bool = False) -> None:
        super().__init__()
        self.folder, self._options = folder, Options(layout=layout, in_step=in_step)

    def work(self) -> Outcome:
        try:
            return pipeline.calibrate(self.folder, self._options, self.tell_whole, self.stopped.is_set)
        except CalibrationRefused:
            self.is_refused = True
            raise

    @property
    def kept_at_quit(self) -> str:
        return "Stages that are done are kept: the next calibration continues there."

    def made(self) -> Path:
        return self.result.cameras


def raw_footage(folder: Path) -> str:
    """What a folder holds that is to be calibrated first, such as "4 videos"; "" for a capture, and without any."""
    with suppress(OSError, FrogError):
        detect(folder)
        return ""
    with suppress(OSError, FrogError):
        return near_layouts.raw_footage(folder)
    return ""
