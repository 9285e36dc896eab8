"""How long a training works: seconds for which its process was stopped, or the computer slept, are none of them."""

from __future__ import annotations

import time

_UNDOUBTED = 0.5  # seconds, which a step may take on a computer that has other things to do


class WorkingTime:
    """Runs from when it is made.

    What computes takes at least as much time of processors as of the clock, and a process that is stopped (Ctrl-Z, a
    laptop's lid) takes none.
    """

    def __init__(self) -> None:
        self._clock, self._processors = time.perf_counter(), time.process_time()

    @property
    def seconds(self) -> float:
        """So far."""
        passed = time.perf_counter() - self._clock
        if passed <= _UNDOUBTED:
            return passed
        return min(passed, max(_UNDOUBTED, time.process_time() - self._processors))
