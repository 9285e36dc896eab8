"""Which frames of moving cameras' films are used, and those frames as images on disk."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import pairwise
from math import ceil
from pathlib import Path

import numpy as np

from ...arrays import ImageArray
from ...errors import FrogError
from ...io.atomic_files import write_atomically
from ...io.child_process import Progress, Stopped
from ..video import decode, load_opencv
from .films import Film

LEAST_IMAGES = 8
"""Images of a camera, below which it is not taken for a moving one."""
_MOST_IMAGES = 300  # of all cameras together
_SCAN_RATE = 3.0  # images a second of a walk-through
_FEWEST, _MOST_SCANNED = 24, 90
_CANDIDATES = 5  # frames among which the sharpest is taken


def sampled(films: Sequence[Film]) -> tuple[list[list[int]], int]:
    """The frames of each film to use, ascending, and every which frame of the slowest film that makes.

    Those of several films lie as near to each other in time as their frames do.

    Raises:
        FrogError: for a film of too few frames.
    """
    for film in films:
        if film.facts.frame_count < LEAST_IMAGES:
            raise FrogError(
                f"{film.path}: found {film.facts.frame_count} frames, expected at least {LEAST_IMAGES} of a moving "
                "camera."
            )
    first = films[0]
    coarsest = max(film.rate / film.facts.frames_per_second for film in films)
    seconds = sum(film.rate * film.facts.frame_count / film.facts.frames_per_second for film in films)
    step = max(1, ceil(seconds / coarsest / _MOST_IMAGES - 1e-6))
    if len(films) == 1:
        return [list(range(0, first.facts.frame_count, step))], step
    interval = step * coarsest
    start, end = min(film.time_of(0) for film in films), max(film.time_of(film.facts.frame_count) for film in films)
    # At the first film's frames: films that are in step have theirs at the same times.
    start = first.time_of(0) - interval * np.ceil((first.time_of(0) - start) / interval)
    wanted = start + interval * np.arange(int((end - start) / interval) + 2)
    found = []
    for film in films:
        frames = {round(film.frame_at(time)) for time in wanted.tolist()}
        found.append(sorted(frame for frame in frames if 0 <= frame < film.facts.frame_count))
    return found, step


def sharpest(film: Film, cancelled: Callable[[], bool]) -> list[int]:
    """Sharp frames of a walk-through, ascending, evenly spread: the sharpest of a few around each place."""
    count = film.facts.frame_count
    wanted = int(np.clip(_SCAN_RATE * count / film.facts.frames_per_second, _FEWEST, _MOST_SCANNED))
    edges = np.linspace(0, count, min(wanted, count) + 1).round().astype(int).tolist()
    tried = [sorted(set(np.linspace(a, b - 1, _CANDIDATES).round().astype(int).tolist())) for a, b in pairwise(edges)]
    frames = [frame for window in tried for frame in window]
    sharp = {}
    for frame, image in zip(frames, decode(film.path, frames), strict=True):
        if cancelled():
            raise Stopped
        sharp[frame] = _sharpness(image)
    return [max(window, key=lambda frame: sharp[frame]) for window in tried]


def written(
    film: Film, frames: Sequence[int], target: Path, progress: Progress, cancelled: Callable[[], bool]
) -> list[Path]:
    """The frames as images without loss in a folder; those that are there already stay.

    Raises:
        Stopped: if ``cancelled`` said so.
        FrogError: if the film cannot be decoded, or an image not be written.
    """
    cv2 = load_opencv()
    paths = {frame: target / f"{frame:06d}.png" for frame in frames}
    missing = [frame for frame in frames if not paths[frame].is_file()]
    for place, (frame, image) in enumerate(zip(missing, decode(film.path, missing), strict=True)):
        progress("images", place, len(missing))
        if cancelled():
            raise Stopped
        _, content = cv2.imencode(".png", cv2.cvtColor(image, cv2.COLOR_RGB2BGR))
        write_atomically(paths[frame], content.tobytes())
    return [paths[frame] for frame in frames]


def _sharpness(image: ImageArray) -> float:
    """The variance of the Laplacian at a quarter of the size, at which noise does not count."""
    cv2 = load_opencv()
    gray = cv2.cvtColor(image, cv2.COLOR_RGB2GRAY)
    scale = min(1.0, 480 / max(gray.shape))
    small = cv2.resize(gray, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA) if scale < 1 else gray
    return float(cv2.Laplacian(small, cv2.CV_64F).var())
