"""How long each phase of a training takes by the clock."""

from __future__ import annotations

import time

from .cancel_token import CancelToken


class PhaseClock:
    """Measures phases that follow each other, without pauses.

    Attributes:
        seconds: of each phase that has ended, by its name.
    """

    def __init__(self, cancel: CancelToken) -> None:
        self._cancel = cancel
        self.seconds: dict[str, float] = {}
        self._began = self.now

    @property
    def now(self) -> float:
        """Seconds on a clock that stands still during pauses."""
        return time.perf_counter() - self._cancel.seconds_paused

    def end(self, phase: str) -> None:
        """A phase has ended, and the next one begins."""
        self.seconds[phase], self._began = self.now - self._began, self.now
