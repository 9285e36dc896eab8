"""The cache of captures' frames in memory, and a thread that computes frames ahead.

A new request replaces all earlier ones. A frame that is needed and not cached is computed at once by the caller.
"""

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

from .. import addon_state
from ..engine.gaussians import GaussianArrays
from ..engine.playback.frame_delta import FrameCache, FrameDelta, Key
from ..engine.playback.player import ScenePlayer
from ..worker import Worker

DEFAULT_MEGABYTES = 1024
MEGABYTE = 1 << 20


@dataclass(frozen=True)
class SceneTime:
    """What an object shows at a frame: a scene at a time in [0, 1].

    What is cached is the source's: edits are made to it each time, in less time than a frame is read.
    """

    scene: ScenePlayer
    time: float

    @property
    def key(self) -> Key:
        return self.scene.token, self.time

    @property
    def source_key(self) -> Key:
        """Of what is cached."""
        return self.scene.source.token, self.time

    def compute(self) -> FrameDelta:
        """The time-dependent part of the source at this time: cached or computed, and cached from now on."""
        delta = frames().find(self.source_key)
        if delta is None:
            delta = self.scene.source.delta_at(self.time)
            frames().keep(self.source_key, delta)
        return delta

    def part(self) -> FrameDelta:
        """The time-dependent part at this time."""
        return self.scene.edited(self.compute())

    def gaussians(self) -> GaussianArrays:
        """All Gaussians. Not cached, as renders visit many times only once."""
        delta = frames().find(self.source_key)
        return self.scene.at(self.time, None if delta is None else self.scene.edited(delta))


class PlaybackCache:
    """The cached frames and the thread that adds to them."""

    def __init__(self) -> None:
        self.frames = FrameCache(DEFAULT_MEGABYTES * MEGABYTE)
        self.worker = Worker("FRoG playback", "a frame could not be computed ahead")


def frames() -> FrameCache:
    """The cached frames."""
    return addon_state.get(PlaybackCache).frames


def worker() -> Worker:
    """The thread that computes frames ahead."""
    return addon_state.get(PlaybackCache).worker


def compute_ahead(times: Iterable[SceneTime]) -> None:
    """Has these computed in order, and drops all earlier requests."""
    uncached = {time.source_key: time.compute for time in times if frames().find(time.source_key) is None}
    worker().ask(uncached, instead=True)


def set_limit(megabytes: int) -> None:
    """Sets the memory limit of the cache. The least recently shown frames are dropped first."""
    frames().set_limit(megabytes * MEGABYTE)


def clear() -> None:
    """Drop all cached frames and pending requests."""
    compute_ahead(())
    frames().forget()


def summary() -> str:
    """For the preferences: ``Cache: 120 MB of 1,024 MB, 34 frames``."""
    used, limit = (round(size / MEGABYTE) for size in (frames().bytes, frames().limit))
    return f"Cache: {used:,} MB of {limit:,} MB, {len(frames()):,} frames"


def stop(*_: Any) -> None:
    """Stops the thread and drops all frames. The thread starts again with the next request."""
    worker().stop()
    frames().forget()
