"""A training's scene while it is trained: handed from the training's thread to whoever shows it.

There is room for one snapshot. The training fills it when it is empty and a share of its time allows; whoever shows
scenes empties it. Nobody waits for the other, nothing piles up, and a scene that nobody looks at costs nothing.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from ...playback.player import ScenePlayer

SHARE = 0.02
"""Of the training's time that snapshots take at most."""
SHORTEST = 1.0
"""Seconds between two snapshots, at least: each is drawn anew."""


class Rest:
    """Says when work has rested long enough for it to take a share of the time at most.

    Both clocks count: a thread that waits for a graphics card uses little of the processor's time, and one beside busy
    threads little of it in much of the wall clock's.

    Args:
        share: of the time, in (0, 1].
        shortest: seconds from one beginning to the next, at least.
        clocks: of the calling thread.
    """

    def __init__(
        self,
        share: float = SHARE,
        shortest: float = SHORTEST,
        clocks: tuple[Callable[[], float], ...] = (time.monotonic, time.thread_time),
    ) -> None:
        self._share, self._shortest, self._clocks = share, shortest, clocks
        self._began: tuple[float, ...] = ()
        self._took: tuple[float, ...] = ()

    @property
    def is_over(self) -> bool:
        """Whether the work may be done again."""
        if not self._began:
            return True
        passed = [now() - began for now, began in zip(self._clocks, self._began, strict=True)]
        enough = all(seconds * self._share >= took for seconds, took in zip(passed, self._took, strict=True))
        return enough and passed[0] >= self._shortest

    @contextmanager
    def measured(self) -> Iterator[None]:
        """Inside, the work is done."""
        self._began = tuple(now() for now in self._clocks)
        try:
            yield
        finally:
            self._took = tuple(now() - began for now, began in zip(self._clocks, self._began, strict=True))


class LiveScene:
    """The place of the snapshot. Every method may be called from any thread.

    Attributes:
        is_wanted: whether anybody looks; the training makes no snapshots otherwise.
    """

    def __init__(self, *, is_wanted: bool = True) -> None:
        self.is_wanted = is_wanted
        self._lock = threading.Lock()
        self._waiting: ScenePlayer | None = None

    @property
    def is_due(self) -> bool:
        """Whether a snapshot is wanted: the last one was taken."""
        return self.is_wanted and self._waiting is None

    def offer(self, scene: ScenePlayer) -> None:
        """Puts a snapshot here, in place of one that nobody took. Its arrays must not be changed any more."""
        with self._lock:
            self._waiting = scene

    def take(self) -> ScenePlayer | None:
        """The newest snapshot, once; None where there is no new one."""
        with self._lock:
            waiting, self._waiting = self._waiting, None
        return waiting
