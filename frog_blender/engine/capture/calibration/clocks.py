"""The films' clocks for calibration: synchronisation by sound and by what moves, as a stage of the pipeline.

Moving cameras are timed by sound, else by timecode: what moves in their images is the cameras themselves.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ...arrays import Float64s, ImageArray
from ...errors import FrogError
from ...io.atomic_files import write_atomically
from ...io.child_process import REQUEST, Progress
from ...io.plain_values import UnfitValue
from ..camera import Camera
from ..capture import Distortion
from ..media import film_tags
from ..synchronization import NamedTracks, Synchronization, draw_curves, synchronize
from ..synchronization.starts import read_note
from .child_process import run
from .clock_task import request_of
from .films import Film
from .work_folder import WorkFolder

Clocks = Mapping[str, tuple[float, float]]
"""Offset in seconds and rate of each camera's film: capture time = offset + rate * film time."""
_IN_STEP = 0.1  # of a frame: films that begin within it began together
_SAME_RATE = 1e-4
_DAY = 86_400.0


@dataclass(frozen=True, eq=False)
class FoundClocks:
    """What synchronisation found.

    Attributes:
        clocks: by camera.
        refusal: why they must not be used, in a sentence; else None.
        warnings: one sentence each.
        synchronization: where they come from; None for clocks that were given or assumed.
    """

    clocks: Clocks
    refusal: str | None = None
    warnings: tuple[str, ...] = ()
    synchronization: Synchronization | None = None

    @property
    def facts(self) -> dict[str, object] | None:
        """Everything, as plain values."""
        return None if self.synchronization is None else self.synchronization.to_json()

    @property
    def curves(self) -> ImageArray | None:
        """(H, W, 3) uint8 RGB drawing of the scores over the offsets."""
        return None if self.synchronization is None else draw_curves(self.synchronization)

    @property
    def by_sound(self) -> bool:
        """Whether sound alone told the clocks of all films."""
        found = self.synchronization
        return found is not None and self.refusal is None and all(c.sources == ("audio",) for c in found.cameras)

    def likely_offsets(self, most: int) -> list[Float64s]:
        """At most so many (C,) offsets in seconds: the clocks', then with one film where it fits nearly as well."""
        found = self.synchronization
        offsets = np.array([offset for offset, _ in self.clocks.values()])
        if found is None:
            return [offsets]
        rivals = [(c.runner_up, i) for i, c in enumerate(found.cameras) if c.runner_up and c.runner_up.is_as_likely]
        moved = []
        for runner_up, film in sorted(rivals, key=lambda rival: -rival[0].share):
            moved.append(offsets.copy())
            moved[-1][film] = runner_up.offset
        return [offsets, *moved][:most]

    def with_offsets(self, offsets: Mapping[str, float]) -> FoundClocks:
        """The same with offsets that were measured closer."""
        found = self.synchronization
        if found is not None:
            found = replace(found, cameras=tuple(replace(c, offset=offsets[c.name]) for c in found.cameras))
        return FoundClocks({n: (offsets[n], rate) for n, (_, rate) in self.clocks.items()}, None, (), found)


Cameras = Mapping[str, tuple[Camera, Distortion | None]]
Synchronize = Callable[
    [Sequence[Film], Cameras, Mapping[str, NamedTracks] | None, WorkFolder, Progress, Callable[[], bool]], FoundClocks
]
"""Finds the films' clocks by cameras that are known, by name, none where they are not, or by points known by name."""


def find_clocks(
    films: Sequence[Film],
    cameras: Cameras,
    tracks: Mapping[str, NamedTracks] | None,
    work: WorkFolder,
    progress: Progress,
    cancelled: Callable[[], bool],
) -> FoundClocks:
    """The films' clocks, by sound, by points known by name, or by motion and moving points.

    Args:
        tracks: points that have the same names in all films, as a person's joints have.
        work: keeps what a second search, with better cameras, needs again.

    Raises:
        Stopped: if ``cancelled`` said so.
        FrogError: if a film cannot be decoded, or the process of the synchronisation died.
    """
    folder = work.path / "synchronization"
    request = request_of({film.name: film.path for film in films}, cameras, tracks, work)
    write_atomically(folder / REQUEST, json.dumps(request).encode())
    result = run("synchronization", folder, progress, cancelled)
    try:
        found = Synchronization.from_json(result)
    except UnfitValue as error:
        raise FrogError(f"{folder}: found a result with {error.found}, expected {error.expected}.") from error
    clocks = found.clocks
    if _is_in_step(clocks, films):
        clocks = dict.fromkeys(clocks, (0.0, 1.0))
    return FoundClocks(clocks, found.refusal, found.warnings, found)


def find_moving_clocks(films: Sequence[Film], progress: Progress, cancelled: Callable[[], bool]) -> FoundClocks:
    """The clocks of moving cameras, and how they were found in a sentence.

    Raises:
        Stopped: if ``cancelled`` said so.
        FrogError: if a film cannot be decoded.
    """

    def tell(_what: str, share: float) -> None:
        progress("synchronisation", round(100 * share), 100)

    paths = {film.name: film.path for film in films}
    found = synchronize(paths, progress=tell, cancelled=cancelled, standing=False)
    if found.refusal is None:
        sentence = "The films were synchronised by their sound alone, which is right to about a frame."
        return FoundClocks(found.clocks, None, (*found.warnings, sentence), found)
    starts = {film.name: read_note(film_tags(film.path), film.facts.frames_per_second) for film in films}
    ahead = {
        film.name: note.seconds - float(film.stamps[0])
        for film in films
        if (note := starts[film.name]) is not None and note.is_timecode
    }
    if len(ahead) < len(films):
        sentence = (
            "Neither sound nor timecode tells when the films of moving cameras began: they were taken to be in step. "
            "If they are not, give their clocks (--clock CAMERA=SECONDS)."
        )
        return FoundClocks({film.name: (0.0, 1.0) for film in films}, None, (sentence,))
    first = ahead[films[0].name]
    lags = {name: (start - first + _DAY / 2) % _DAY - _DAY / 2 for name, start in ahead.items()}  # across midnight
    clocks = {name: (lag - min(lags.values()), 1.0) for name, lag in lags.items()}
    return FoundClocks(clocks, None, ("The films were synchronised by their timecodes, which have whole frames.",))


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
