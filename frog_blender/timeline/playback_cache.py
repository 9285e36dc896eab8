"""The cache of captures' frames in memory, and a thread that computes frames ahead.

The thread gets plain values and never touches Blender.  It computes one frame at a time, and a new request replaces all
earlier ones. A frame that is needed and not cached is computed at once by the caller.
"""

from __future__ import annotations

import sys
import threading
from collections import deque
from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from .. import addon_state
from ..engine.playback.frame_delta import FrameCache, Key

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
    """What an object shows at a frame: a scene at a time in [0, 1].

    Attributes:
        bake: what its source may be in, which can be one of a scene with more Gaussians.
        rows: (K,) which of the Gaussians that move in the bake are those that move in ``scene``; None for all.

    What is cached and baked is the source's: edits are made to it each time, in less time than a frame is read.
    """

    scene: ScenePlayer
    time: float
    bake: Bake | None = None
    rows: np.ndarray | None = field(default=None, compare=False)

    @property
    def key(self) -> Key:
        return self.scene.token, self.time

    @property
    def source_key(self) -> Key:
        """Of what is cached."""
        return self.scene.source.token, self.time

    def compute(self) -> FrameDelta:
        """The time-dependent part of the source at this time: cached, baked or computed, and cached from now on."""
        found = frames().find(self.source_key)
        if found is None:
            found = self._baked() or self.scene.source.delta_at(self.time)
            frames().keep(self.source_key, found)
        return found

    def part(self) -> FrameDelta:
        """The time-dependent part at this time."""
        return self.scene.edited(self.compute())

    def gaussians(self) -> GaussianArrays:
        """All Gaussians. Not cached, as renders visit many times only once."""
        found = frames().find(self.source_key) or self._baked()
        return self.scene.at(self.time, None if found is None else self.scene.edited(found))

    def _baked(self) -> FrameDelta | None:
        if self.bake is None or not self.scene.source.changing:
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
        """Compute these in order, and drop all earlier requests."""
        uncached = (scene_time for scene_time in times if self._frames.find(scene_time.source_key) is None)
        wanted = deque(uncached)
        with self._changed:
            self._wanted = wanted
            if wanted and self._thread is None:
                # A daemon, because Python joins other threads before it runs atexit, which ends this one.
                self._thread = threading.Thread(target=self._work, name="FRoG playback", daemon=True)
                self._thread.start()
            self._changed.notify_all()

    def wait(self, seconds: float) -> bool:
        """Waits until all requests are computed, for scripts and tests; False on timeout."""
        with self._changed:
            return self._changed.wait_for(lambda: not self._wanted and not self._busy, seconds)

    def stop(self) -> None:
        """Stops the thread after its current frame."""
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
                following.compute()
            except Exception as error:  # showing the frame raises it again; the thread goes on
                print(f"FRoG: a frame could not be computed ahead ({type(error).__name__}: {error}).", file=sys.stderr)


class PlaybackCache:
    """The cached frames and the thread that adds to them."""

    def __init__(self) -> None:
        self.frames = FrameCache(DEFAULT_MEGABYTES * MEGABYTE)
        self.worker = PrefetchWorker(self.frames)


def frames() -> FrameCache:
    """The cached frames."""
    return addon_state.get(PlaybackCache).frames


def worker() -> PrefetchWorker:
    """The thread that computes frames ahead."""
    return addon_state.get(PlaybackCache).worker


def set_limit(megabytes: int) -> None:
    """Sets the memory limit of the cache. The least recently shown frames are dropped first."""
    frames().limit = megabytes * MEGABYTE


def clear() -> None:
    """Drop all cached frames and pending requests."""
    worker().ask(())
    frames().forget()


def summary() -> str:
    """For the panel: ``Cache: 120 MB of 1,024 MB, 34 frames``."""
    used, limit = (round(size / MEGABYTE) for size in (frames().bytes, frames().limit))
    return f"Cache: {used:,} MB of {limit:,} MB, {len(frames()):,} frames"


def stop() -> None:
    """Stops the thread and drops all frames. The thread starts again with the next request."""
    worker().stop()
    frames().forget()
