"""How long a training works: seconds for which its process was stopped, or the computer slept, are none of them."""

from __future__ import annotations

import time

_UNDOUBTED = 0.5  # seconds, which a step may take on a computer that has other things to do


def worked_since(clock: float, processors: float) -> float:
    """Seconds of work since ``time.perf_counter()`` was ``clock`` and ``time.process_time()`` was ``processors``."""
    return worked(time.perf_counter() - clock, time.process_time() - processors)


def worked(passed: float, computed: float) -> float:
    """Seconds of work in so many seconds, during which the process took ``computed`` seconds of processors.

    What computes takes at least as much time of processors as of the clock, and a process that is stopped (Ctrl-Z, a
    laptop's lid) takes none.
    """
    return passed if passed <= _UNDOUBTED else min(passed, max(_UNDOUBTED, computed))
