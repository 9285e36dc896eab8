"""The films' clocks for calibration: synchronisation by sound and by what moves, as a stage of the pipeline."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

from ...arrays import ImageArray
from ...errors import FrogError
from ...io.atomic_files import write_atomically
from ...io.child_process import REQUEST, Progress
from ...io.plain_values import UnfitValue
from ..camera import Camera
from ..capture import Distortion
from ..synchronization import Synchronization, draw_curves
from .child_process import run
from .clock_task import request_of
from .films import Film
from .work_folder import WorkFolder

Clocks = Mapping[str, tuple[float, float]]
"""Offset in seconds and rate of each camera's film: capture time = offset + rate * film time."""
_IN_STEP = 0.1  # of a frame: films that begin within it began together
_SAME_RATE = 1e-4


@dataclass(frozen=True, eq=False)
class FoundClocks:
    """What synchronisation found.

    Attributes:
        clocks: by camera.
        refusal: why they must not be used, in a sentence; else None.
        warnings: one sentence each.
        facts: everything, as plain values.
        curves: (H, W, 3) uint8 RGB drawing of the scores over the offsets.
    """

    clocks: Clocks
    refusal: str | None = None
    warnings: tuple[str, ...] = ()
    facts: Mapping[str, object] | None = None
    curves: ImageArray | None = None


Synchronize = Callable[
    [Sequence[Film], Mapping[str, tuple[Camera, Distortion | None]], WorkFolder, Progress, Callable[[], bool]],
    FoundClocks,
]
"""Finds the films' clocks by cameras that are known, by name; none where they are not."""


def find_clocks(
    films: Sequence[Film],
    cameras: Mapping[str, tuple[Camera, Distortion | None]],
    work: WorkFolder,
    progress: Progress,
    cancelled: Callable[[], bool],
) -> FoundClocks:
    """The films' clocks, by sound, motion and moving points.

    Args:
        work: keeps what a second search, with better cameras, needs again.

    Raises:
        Stopped: if ``cancelled`` said so.
        FrogError: if a film cannot be decoded, or the process of the synchronisation died.
    """
    folder = work.path / "synchronization"
    request = request_of({film.name: film.path for film in films}, dict(cameras), work)
    write_atomically(folder / REQUEST, json.dumps(request).encode())
    result = run("synchronization", folder, progress, cancelled)
    try:
        found = Synchronization.from_json(result)
    except UnfitValue as error:
        raise FrogError(f"{folder}: found a result with {error.found}, expected {error.expected}.") from error
    clocks = {camera.name: (camera.offset, camera.rate) for camera in found.cameras}
    if _is_in_step(clocks, films):
        clocks = dict.fromkeys(clocks, (0.0, 1.0))
    return FoundClocks(clocks, found.refusal, found.warnings, found.to_json(), draw_curves(found))


def with_clocks(films: Sequence[Film], clocks: Clocks) -> list[Film]:
    """The films with the clocks that are known."""
    return [
        replace(film, offset=clocks[film.name][0], rate=clocks[film.name][1]) if film.name in clocks else film
        for film in films
    ]


def differ(one: Clocks, other: Clocks, films: Sequence[Film]) -> bool:
    """Whether any film's clock differs by more than a tenth of a frame at its start."""
    return any(
        abs(one[film.name][0] - other[film.name][0]) * film.facts.frames_per_second > _IN_STEP
        for film in films
        if film.name in one and film.name in other
    )


def _is_in_step(clocks: Clocks, films: Sequence[Film]) -> bool:
    """Whether all began together and ran alike: what is left is the error of finding it."""
    offsets = [clocks[film.name][0] for film in films if film.name in clocks]
    rates = [clocks[film.name][1] for film in films if film.name in clocks]
    if len(offsets) < len(films):
        return False
    frame = 1 / max(film.facts.frames_per_second for film in films)
    return max(offsets) - min(offsets) < 2 * _IN_STEP * frame and all(abs(rate - 1) < _SAME_RATE for rate in rates)
