"""A training's scene while it is trained: handed from the training's thread to whoever shows it.

There is room for one snapshot, the newest. The training renews it when a share of its time allows, taken or not: who
draws slowly sees what there is then, not what there was when it last looked. Nobody waits for the other, nothing piles
up, and a scene that nobody wants costs nothing.
"""

import time
from collections import deque
from collections.abc import Iterator
from contextlib import contextmanager, suppress

from ...playback.player import ScenePlayer

SHARE = 0.02
"""Of the training's time that snapshots take at most."""
SHORTEST = 1.0
"""Seconds between two snapshots, at least: each is drawn anew."""


class Rest:
    """Says when work has rested long enough for it to take a share of the time at most.

    Both clocks of the calling thread count: one that waits for a graphics card uses little of the processor's time, and
    one beside busy threads little of it in much of the wall clock's.
    """

    def __init__(self) -> None:
        self._wall_end = self._processor_end = float("-inf")

    @property
    def is_over(self) -> bool:
        """Whether the work may be done again."""
        return time.monotonic() >= self._wall_end and time.thread_time() >= self._processor_end

    @contextmanager
    def measured(self) -> Iterator[None]:
        """Inside, the work is done."""
        wall, processor = time.monotonic(), time.thread_time()
        try:
            yield
        finally:
            self._wall_end = wall + max(SHORTEST, (time.monotonic() - wall) / SHARE)
            self._processor_end = processor + (time.thread_time() - processor) / SHARE


class LiveScene:
    """The place of the snapshot. Every method may be called from any thread.

    Attributes:
        is_wanted: whether anybody looks; the training makes no snapshots otherwise.
    """

    def __init__(self, *, is_wanted: bool = True) -> None:
        self.is_wanted = is_wanted
        self._waiting = deque[ScenePlayer](maxlen=1)

    def offer(self, scene: ScenePlayer) -> None:
        """Puts a snapshot here, in place of one that nobody took. Its arrays must not be changed any more."""
        self._waiting.append(scene)

    def take(self) -> ScenePlayer | None:
        """The newest snapshot, once; None where there is no new one."""
        with suppress(IndexError):
            return self._waiting.pop()
        return None
