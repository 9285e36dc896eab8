"""What a person asks of a training that runs: hold, go on, end, show another camera. Any thread may ask."""

from __future__ import annotations

import threading
from collections.abc import Callable


class CancelToken:
    """Between its steps a training calls it: true when it is to end. While paused the call waits.

    Attributes:
        preview_camera: whose view the previews show from now on; None leaves it to the job.
    """

    def __init__(self, ends: Callable[[], bool] = lambda: False) -> None:
        """``ends`` is asked besides: a front end's own way to cancel."""
        self.preview_camera: str | None = None
        self._ends = ends
        self._changed = threading.Condition()
        self._paused = self._cancelled = False

    @classmethod
    def of(cls, cancelled: Callable[[], bool]) -> CancelToken:
        """What ``run_training`` was given, as a control."""
        return cancelled if isinstance(cancelled, CancelToken) else cls(cancelled)

    @property
    def paused(self) -> bool:
        """True from ``pause`` until ``resume`` or ``cancel``."""
        return self._paused and not self._cancelled

    @property
    def ended(self) -> bool:
        """True when the training is to end, paused or not."""
        return self._cancelled or self._ends()

    def pause(self) -> None:
        """Hold the training before its next step."""
        with self._changed:
            self._paused = True

    def resume(self) -> None:
        """Go on after a pause."""
        with self._changed:
            self._paused = False
            self._changed.notify_all()

    def cancel(self) -> None:
        """End the training, paused or not."""
        with self._changed:
            self._cancelled = True
            self._changed.notify_all()

    def __call__(self) -> bool:
        with self._changed:
            self._changed.wait_for(lambda: self._cancelled or not self._paused)
        return self.ended
