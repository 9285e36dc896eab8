"""How long a training works: seconds for which its process was stopped, or the computer slept, are none of them."""

from __future__ import annotations

import time

_UNDOUBTED = 0.5  # seconds, which a step may take on a computer that has other things to do


def worked_since(clock: float, processors: float) -> float:
    """Seconds of work since ``time.perf_counter()`` was ``clock`` and ``time.process_time()`` was ``processors``.

    What computes takes at least as much time of processors as of the clock, and a process that is stopped (Ctrl-Z, a
    laptop's lid) takes none.
    """
    passed = time.perf_counter() - clock
    if passed <= _UNDOUBTED:
        return passed
    return min(passed, max(_UNDOUBTED, time.process_time() - processors))
