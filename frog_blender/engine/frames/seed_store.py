"""Seed points kept beside the decoded frames: found once for a capture, however often it is trained or resumed."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable
from contextlib import suppress
from dataclasses import asdict
from pathlib import Path

import numpy as np

from ..capture.capture import Capture
from ..capture.seeds import Seeds, SeedSettings, find_seeds
from ..errors import FrogError
from ..io.atomic_files import atomic_file
from ..io.numpy_files import NUMBERS, TEXT, read_npz
from .store import FrameStore

_LONGEST_ORIGIN = 1000
_VERSION = 6  # raise it when the same capture would get other seeds


def stored_seeds(
    capture: Capture,
    store: FrameStore,
    settings: SeedSettings,
    progress: Callable[[int, int], None] = lambda done, total: None,
) -> Seeds:
    """``find_seeds``, or what it found for the same images, cameras and settings before."""
    path = store.folder / f"seeds-{_key(capture, settings)}.npz"
    if (kept := _kept(path, settings.count_limit, capture.frame_count)) is not None:
        return kept
    seeds = find_seeds(capture, store, settings, progress)
    times = {} if seeds.frames is None else {"frames": seeds.frames}
    with suppress(OSError), atomic_file(path) as file:  # what a disk does not take is found again
        np.savez(file, points=seeds.points, colors=seeds.colors, origin=np.array(seeds.origin), **times)
    return seeds


def _kept(path: Path, most: int, frame_count: int) -> Seeds | None:
    """What was kept; None where that is not there, or damaged, so that it is found again."""
    if not path.is_file():
        return None
    try:
        arrays = read_npz(path, "seed points", lambda *_: None, 7 * max(most, 0) + _LONGEST_ORIGIN, NUMBERS + TEXT)
        points, colors, origin = arrays["points"], arrays["colors"], arrays["origin"]
        frames = arrays.get("frames")
    except (FrogError, KeyError):
        return None
    fits = points.dtype == colors.dtype == np.float32 and points.shape == colors.shape == (len(points), 3)
    whole = fits and len(points) > 0 and bool(np.isfinite(points).all() and ((colors >= 0) & (colors <= 1)).all())
    if frames is not None:
        there = frames.dtype == np.float32 and frames.shape == (len(points),)
        whole = whole and there and not bool(((frames < 0) | (frames >= frame_count)).any())
    named = origin.dtype.kind in TEXT and not origin.shape
    return Seeds(points, colors, str(origin), frames) if whole and named else None


def _key(capture: Capture, settings: SeedSettings) -> str:
    """Everything that decides the seeds but the frames themselves, for which the store's folder stands."""
    points = b"" if capture.points is None else np.ascontiguousarray(capture.points).tobytes()
    decides = {
        "version": _VERSION,
        "options": asdict(settings),
        "cameras": [camera.to_json() for camera in capture.cameras],
        "test": [sorted(capture.test_cameras), sorted(capture.test_frames)],
        "near_far": capture.near_far,
        "background": capture.background,
        "points": hashlib.sha256(points).hexdigest(),
    }
    return hashlib.sha256(json.dumps(decides, sort_keys=True).encode()).hexdigest()[:16]
