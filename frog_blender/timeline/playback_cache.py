"""Frames of captures that are kept in memory, and a thread that computes the ones to come.

The thread is given plain values and never touches Blender.  It computes one frame at a time and forgets what it was
asked for as soon as it is asked for something else; whoever needs a frame that is not here computes it at once.
"""

from __future__ import annotations

import sys
import threading
from collections import deque
from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from .. import addon_state
from ..engine.playback.frame_cache import FrameCache, Key

if TYPE_CHECKING:
    import numpy as np

    from ..engine.gaussians import GaussianArrays
    from ..engine.playback.bake import Bake
    from ..engine.playback.frame_delta import FrameDelta
    from ..engine.playback.player import ScenePlayer

DEFAULT_MEGABYTES = 1024
MEGABYTE = 1 << 20


@dataclass(frozen=True)
class SceneTime:
    """What an object shows at some frame: a scene at a time in [0, 1].

    Attributes:
        bake: it may be in, which can be one of a scene with more Gaussians.
        rows: (K,) which of the Gaussians that move in the bake are those that move in ``scene``; None for all.
    """

    scene: ScenePlayer
    time: float
    bake: Bake | None = None
    rows: np.ndarray | None = field(default=None, compare=False)

    @property
    def key(self) -> Key:
        return self.scene.token, self.time

    def part(self) -> FrameDelta:
        """What changes in time, at this time: kept, baked, or computed at once; kept from now on."""
        found = frames().find(self.key)
        if found is None:
            found = self._baked() or self.scene.delta_at(self.time)
            frames().keep(self.key, found)
        return found

    def gaussians(self) -> GaussianArrays:
        """All of them; renders go through many times once, so nothing is kept for them."""
        return self.scene.at(self.time, frames().find(self.key) or self._baked())

    def _baked(self) -> FrameDelta | None:
        if self.bake is None or not self.scene.changing:
            return None
        return self.bake.find(self.time, self.rows)


class PrefetchWorker:
    """A thread that fills a cache of frames; it starts with the first request and ends with ``stop``."""

    def __init__(self, frames: FrameCache) -> None:
        self._frames = frames
        self._wanted: deque[SceneTime] = deque()
        self._changed = threading.Condition()
        self._thread: threading.Thread | None = None
        self._busy = False

    def ask(self, times: Iterable[SceneTime]) -> None:
        """Compute these, first things first, and nothing else any more."""
        wanted = deque(each for each in times if self._frames.find(each.key) is None)  # what is there stays there
        with self._changed:
            self._wanted = wanted
            if wanted and self._thread is None:
                # A daemon, because Python waits for other threads before it runs atexit, where this one is ended.
                self._thread = threading.Thread(target=self._work, name="FRoG playback", daemon=True)
                self._thread.start()
            self._changed.notify_all()

    def wait(self, seconds: float) -> bool:
        """Until everything that was asked for is there, for scripts and tests; False when it takes longer."""
        with self._changed:
            return self._changed.wait_for(lambda: not self._wanted and not self._busy, seconds)

    def stop(self) -> None:
        """Ends the thread after the frame that it is at."""
        with self._changed:
            thread, self._thread = self._thread, None
            self._wanted.clear()
            self._changed.notify_all()
        if thread is not None:
            thread.join()

    @property
    def is_alive(self) -> bool:
        return self._thread is not None

    def _work(self) -> None:
        me = threading.current_thread()
        while True:
            with self._changed:
                self._busy = False
                self._changed.notify_all()
                self._changed.wait_for(lambda: self._wanted or self._thread is not me)
                if self._thread is not me:
                    return
                following = self._wanted.popleft()
                self._busy = True
            try:
                following.part()
            except Exception as error:  # whoever shows the frame meets it too; the thread goes on
                print(f"FRoG: a frame could not be computed ahead ({type(error).__name__}: {error}).", file=sys.stderr)


class PlaybackCache:
    """The frames in memory and the thread that adds to them."""

    def __init__(self) -> None:
        self.frames = FrameCache(DEFAULT_MEGABYTES * MEGABYTE)
        self.worker = PrefetchWorker(self.frames)


def frames() -> FrameCache:
    """The frames that are kept."""
    return addon_state.get(PlaybackCache).frames


def worker() -> PrefetchWorker:
    """The thread that computes frames ahead."""
    return addon_state.get(PlaybackCache).worker


def set_limit(megabytes: int) -> None:
    """How much memory the frames may take; the least recently shown go first."""
    frames().limit = megabytes * MEGABYTE


def clear() -> None:
    """Forget every frame, and what was to be computed."""
    worker().ask(())
    frames().forget()


def summary() -> str:
    """For the panel: ``Cache: 120 MB of 1,024 MB, 34 frames``."""
    used, limit = (round(size / MEGABYTE) for size in (frames().bytes, frames().limit))
    return f"Cache: {used:,} MB of {limit:,} MB, {len(frames()):,} frames"


def stop() -> None:
    """Ends the thread and forgets every frame; the thread starts again with the next request."""
    worker().stop()
    frames().forget()
