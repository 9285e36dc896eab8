"""Seed points kept beside the decoded frames: found once for a capture, however often it is trained or resumed."""

from collections.abc import Callable
from contextlib import suppress
from dataclasses import asdict

import numpy as np

from ..capture.capture import Capture
from ..capture.seeds import Seeds, SeedSettings, find_seeds
from ..errors import FrogError
from ..io.work_folder import WorkFolder, key_of
from .store import FrameStore

_VERSION = 6  # raise it when the same capture would get other seeds


def stored_seeds(
    capture: Capture,
    store: FrameStore,
    settings: SeedSettings,
    progress: Callable[[int, int], None] = lambda done, total: None,
) -> Seeds:
    """``find_seeds``, or what it found for the same images, cameras and settings before."""
    work, key = WorkFolder(store.folder), _key(capture, settings)
    if (kept := work.load("seeds", key)) is not None:
        return Seeds(kept["points"], kept["colors"], kept["origin"].tobytes().decode(), kept.get("frames"))
    seeds = find_seeds(capture, store, settings, progress)
    origin = np.frombuffer(seeds.origin.encode(), np.uint8)
    times = {} if seeds.frames is None else {"frames": seeds.frames}
    with suppress(FrogError):  # what a disk does not take is found again
        work.keep("seeds", key, {"points": seeds.points, "colors": seeds.colors, "origin": origin, **times})
    return seeds


def _key(capture: Capture, settings: SeedSettings) -> str:
    """Everything that decides the seeds but the frames themselves, for which the store's folder stands."""
    cameras = [camera.to_json() for camera in capture.cameras]
    held_out = [sorted(capture.test_cameras), sorted(capture.test_frames)]
    points = np.zeros((0, 3)) if capture.points is None else capture.points
    return key_of(_VERSION, asdict(settings), cameras, held_out, capture.near_far, capture.background, points)
