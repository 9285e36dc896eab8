"""Pausing, resuming and cancelling a training, and choosing its preview, from any thread."""

import threading
import time
from collections.abc import Callable

_LOOKS = 0.5  # seconds of a pause between questions to the front end's own way to cancel, which tells nobody


class CancelToken:
    """Called by a training between its steps: true when it is to end. While paused the call waits.

    Attributes:
        preview_camera: whose view the previews show from now on; None leaves it to the job.
        seconds_paused: that callers have waited so far.
    """

    def __init__(self, ends: Callable[[], bool] = lambda: False) -> None:
        """``ends`` is asked as well: a front end's own way to cancel."""
        self.preview_camera: str | None = None
        self.seconds_paused = 0.0
        self._ends = ends
        self._changed = threading.Condition()
        self._paused = self._cancelled = False

    @property
    def paused(self) -> bool:
        """True from ``pause`` until ``resume`` or ``cancel``."""
        return self._paused and not self._cancelled

    @property
    def ended(self) -> bool:
        """True when the training is to end, paused or not."""
        return self._cancelled or self._ends()

    def pause(self) -> None:
        """Halt the training before its next step."""
        with self._changed:
            self._paused = True

    def resume(self) -> None:
        """Continue after a pause."""
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
            while self.paused and not self._ends():
                began = time.perf_counter()
                self._changed.wait(_LOOKS)
                self.seconds_paused += time.perf_counter() - began
        return self.ended
