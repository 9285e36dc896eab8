"""The films' clocks for calibration: synchronisation by sound and by what moves, as a stage of the pipeline.

Moving cameras are timed by sound, else by timecode: what moves in their images is the cameras themselves.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from ...arrays import Float64s, ImageArray
from ...errors import FrogError
from ...io.atomic_files import write_atomically
from ...io.child_process import REQUEST, Progress
from ...io.plain_values import JsonList, JsonObject, UnfitValue
from ..camera import Camera
from ..capture import Distortion
from ..media import film_tags
from ..readers.geometry import distortion
from ..synchronization import NamedTracks, Synchronization, draw_curves, synchronize
from ..synchronization.starts import read_timecode, timecode_lag
from ..video import load_opencv
from .calibration import child_task
from .films import Film
from .work_folder import WorkFolder

Clocks = Mapping[str, tuple[float, float]]
"""Offset in seconds and rate of each camera's film: capture time = offset + rate * film time."""
_IN_STEP = 0.1  # of a frame: films that begin within it began together
_SAME_RATE = 1e-4
_PARTS = 1000  # of the whole, in which progress is told


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
    request = _request_of({film.name: film.path for film in films}, cameras, tracks, work)
    write_atomically(folder / REQUEST, json.dumps(request).encode())
    result = child_task("clocks:synchronization").run(folder, progress, cancelled)
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
    found = synchronize(paths, progress=tell, cancelled=cancelled, tracks={})
    if found.refusal is None:
        sentence = "The films were synchronised by their sound alone, which is right to about a frame."
        return FoundClocks(found.clocks, None, (*found.warnings, sentence), found)
    said = [read_timecode(film_tags(film.path), film.facts.frames_per_second) for film in films]
    starts = [code - float(film.stamps[0]) for film, code in zip(films, said, strict=True) if code is not None]
    if len(starts) < len(films):
        sentence = (
            "Neither sound nor timecode tells when the films of moving cameras began: they were taken to be in step. "
            "If they are not, give their clocks (--clock CAMERA=SECONDS)."
        )
        return FoundClocks({film.name: (0.0, 1.0) for film in films}, None, (sentence,))
    lags = [timecode_lag(starts[0], start) for start in starts]
    clocks = {film.name: (lag - min(lags), 1.0) for film, lag in zip(films, lags, strict=True)}
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


# --- the child: its matrix library has one thread, for the matrices are small


def _request_of(
    films: Mapping[str, Path],
    cameras: Mapping[str, tuple[Camera, Distortion | None]],
    tracks: Mapping[str, NamedTracks] | None,
    work: WorkFolder,
) -> JsonObject:
    """What ``clocks`` is asked; lenses have OpenCV's coefficients alone, as calibration finds them."""
    return {
        "tracks": tracks and {name: [track.times.tolist(), _plain(track.positions)] for name, track in tracks.items()},
        "work": str(work.path.absolute()),
        "films": {name: str(path.absolute()) for name, path in films.items()},
        "cameras": [
            {
                "name": name,
                "size": [camera.width, camera.height],
                "intrinsics": camera.intrinsics.tolist(),
                "pose": camera.world_to_camera.tolist(),
                "distortion": [] if lens is None else np.asarray(lens.coefficients).tolist(),
            }
            for name, (camera, lens) in cameras.items()
        ],
    }


def _plain(values: Float64s) -> JsonList:
    """Lists of numbers, None for NaN."""
    plain = values.astype(object)
    plain[np.isnan(values)] = None
    return list(plain.tolist())


def synchronization(request: JsonObject, tell: Callable[[str, int, int], None]) -> JsonObject:
    """The synchronisation of a request's films as plain values (``Synchronization.to_json``)."""
    load_opencv().setNumThreads(1)  # films and pairs of them share the processors
    cameras, lenses = {}, {}
    for entry in request["cameras"]:
        name, (width, height) = str(entry["name"]), entry["size"]
        intrinsics, pose = (np.asarray(entry[key], np.float64) for key in ("intrinsics", "pose"))
        cameras[name] = Camera(name, int(width), int(height), intrinsics, pose)
        lenses[name] = distortion(np.asarray(entry["distortion"], np.float64)) if entry["distortion"] else None

    def progress(_what: str, share: float) -> None:
        tell("synchronisation", round(share * _PARTS), _PARTS)

    films = {str(name): Path(path) for name, path in request["films"].items()}
    tracks = request["tracks"] and {
        str(name): NamedTracks(*(np.asarray(values, np.float64) for values in track))
        for name, track in request["tracks"].items()
    }
    kept = WorkFolder(Path(request["work"]))
    found = synchronize(films, cameras or None, distortions=lenses, tracks=tracks, progress=progress, kept=kept)
    return found.to_json()
