"""Raw films of several cameras to one clock a camera, from every source that they offer."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from math import isnan
from pathlib import Path

from ..camera import Camera
from ..capture import Distortion
from ..media import film_tags
from .audio import audio_lag, read_audio
from .curves import camera_curve, runner_up
from .energy import energy_lag
from .epipolar import fundamental
from .lags import NamedTracks, track_lag
from .look import Look, look_at
from .motion import Rig, coarse_lags, find_points, fine_lags, score_at
from .moving_points import MovingPoints
from .pair import PairLag
from .recordings import Recording, open_recording
from .report import reported
from .solve import Solution, solve
from .straighten import straightened
from .synchronization import RunnerUp, Synchronization
from .timecode import read_note, window
from .work import Kept, Progress, Work, forward_only, in_threads

_SURE = 0.75  # of the weight of every film's pairs must agree for a start to be searched near only


def synchronize(
    films: Mapping[str, Path],
    cameras: Mapping[str, Camera] | None = None,
    *,
    distortions: Mapping[str, Distortion | None] | None = None,
    tracks: Mapping[str, NamedTracks] | None = None,
    progress: Progress = lambda what, share: None,
    cancelled: Callable[[], bool] = lambda: False,
    kept: Kept | None = None,
) -> Synchronization:
    """The offset and the rate of every camera's clock.

    Args:
        films: a video for each camera's name.
        cameras: where known, the answer is right to a few hundredths of a frame; at the films' sizes or others of the
            same proportions. Films without a camera are synchronised by sound and motion energy.
        distortions: of the cameras' lenses.
        tracks: points known by name in all films, as a person's joints are, in pixels of the films as stored: where
            cameras are not known, or see nothing else alike.
        progress, cancelled: see work.Work; asked and told from several threads.
        kept: keeps what a second synchronisation of the same films needs again.

    Raises:
        FrogError: if a film cannot be decoded.
        SynchronizationCancelled: if the user ended it.
    """
    work = Work(forward_only(progress), cancelled)
    opened = [open_recording(name, path) for name, path in films.items()]
    if len(opened) < 2:
        return reported(opened, solve(len(opened), [], 1.0, 1.0), [])
    parts = [work.part(*_share(0.0, 0.3, number, len(opened))) for number in range(len(opened))]
    looks = in_threads(lambda number: look_at(opened[number], parts[number], kept), range(len(opened)))
    pairs = _start(opened, looks, work.part(0.3, 0.4))
    if tracks is not None:
        pairs += _track_lags(opened, tracks, (cameras or {}, distortions or {}), work.part(0.4, 0.5))
        named = [pair for pair in pairs if pair.source == "tracks"]
        pairs = named or pairs
    solution = _solved(opened, pairs)
    rivals: dict[int, RunnerUp] = {}
    if cameras is not None:
        calibrated = [i for i, film in enumerate(opened) if film.name in cameras]
        if len(calibrated) >= 2:
            rig = _rig(
                opened, looks, calibrated, (cameras, distortions or {}), solution, work.part(0.5, 0.75), kept=kept
            )
            wide = pairs
            part = work.part(0.75, 0.95)
            pairs, solution = _refined(opened, rig, calibrated, pairs, solution, part)
            rivals = _rivals(opened, rig, calibrated, wide, solution, work.part(0.95, 1.0))
    work.step("Synchronised", 1, 1)
    return reported(opened, solution, pairs, rivals)


def _share(start: float, end: float, number: int, count: int) -> tuple[float, float]:
    """The part of [start, end] that one of several equal steps takes."""
    return start + (end - start) * number / count, start + (end - start) * (number + 1) / count


def _solved(films: Sequence[Recording], pairs: Sequence[PairLag]) -> Solution:
    frame = max(film.interval for film in films)
    return solve(len(films), pairs, frame, max(film.duration for film in films))


def _start(films: Sequence[Recording], looks: Sequence[Look], work: Work) -> list[PairLag]:
    """Lags from sound where there is some, else from motion energy; those that timecodes exclude come last."""
    sounds = []
    for number, film in enumerate(films):
        work.part(0.0, 0.5).step(f"Listening to {film.name}", number, len(films))
        sounds.append(read_audio(film))
    starts = [read_note(film_tags(film.path), 1 / film.interval) for film in films]
    found = []
    for first in range(len(films)):
        work.part(0.5, 1.0).step("Comparing sound and motion", first, len(films))
        for second in range(first + 1, len(films)):
            pair = (first, second)
            heard, other = sounds[first], sounds[second]
            lag = None if heard is None or other is None else audio_lag(pair, (heard, other))
            if lag is None:
                step = min(films[first].interval, films[second].interval)
                lag = energy_lag(pair, (looks[first].energy, looks[second].energy), step)
            if lag is not None:
                found.append(_preferred(lag, window(starts[first], starts[second])))
    return found


def _preferred(lag: PairLag, allowed: tuple[float, float] | None) -> PairLag:
    """The best maximum inside a window; without one inside, or a window, the best of all."""
    if allowed is None or allowed[0] <= lag.lag <= allowed[1]:
        return lag
    inside = [other for other in lag.others if allowed[0] <= other[0] <= allowed[1]]
    if not inside:
        return lag
    rest = ((lag.lag, lag.score), *(other for other in lag.others if other != inside[0]))
    return replace(lag, lag=inside[0][0], score=inside[0][1], others=rest)


def _track_lags(
    films: Sequence[Recording],
    tracks: Mapping[str, NamedTracks],
    lenses: tuple[Mapping[str, Camera], Mapping[str, Distortion | None]],
    work: Work,
) -> list[PairLag]:
    found = []
    pairs = [(i, j) for i in range(len(films)) for j in range(i + 1, len(films))]
    for number, pair in enumerate(pairs):
        work.step("Comparing named points", number, len(pairs))
        names = [films[film].name for film in pair]
        known = [_camera(films[film], lenses[0]) for film in pair if films[film].name in lenses[0]]
        seen = [tracks[name] for name in names if name in tracks]
        if len(seen) < 2:
            continue
        matrix = None
        if len(known) == 2:
            matrix = fundamental(known[0], known[1])
            straight = [straightened(known[i], lenses[1].get(names[i]), seen[i].positions) for i in (0, 1)]
            seen = [replace(one, positions=positions) for one, positions in zip(seen, straight, strict=True)]
        frame = max(films[film].interval for film in pair)
        width = max(films[film].width for film in pair)
        lag = track_lag(pair, (seen[0], seen[1]), frame, width, matrix)
        found += [] if lag is None else [lag]
    return found


def _camera(film: Recording, cameras: Mapping[str, Camera]) -> Camera:
    """A film's camera at the film's size."""
    return cameras[film.name].resized(film.width, film.height)


def _rig(
    films: Sequence[Recording],
    looks: Sequence[Look],
    calibrated: Sequence[int],
    lenses: tuple[Mapping[str, Camera], Mapping[str, Distortion | None]],
    start: Solution,
    work: Work,
    *,
    kept: Kept | None,
) -> Rig:
    def of_position(position: int) -> tuple[Camera, MovingPoints]:
        number = calibrated[position]
        film, part = films[number], work.part(*_share(0.0, 1.0, position, len(calibrated)))
        camera = _camera(film, lenses[0])
        found = find_points(film, looks[number], start.clocks, number, part, kept)
        return camera, replace(found, tracks=straightened(camera, lenses[1].get(film.name), found.tracks))

    views = in_threads(of_position, range(len(calibrated)))
    chosen = tuple(films[number] for number in calibrated)
    return Rig(chosen, tuple(camera for camera, _ in views), tuple(points for _, points in views))


def _refined(
    films: Sequence[Recording],
    rig: Rig,
    calibrated: Sequence[int],
    pairs: list[PairLag],
    start: Solution,
    work: Work,
) -> tuple[list[PairLag], Solution]:
    """Lags of moving points in place of the start's, for the films whose cameras are known."""
    clocks = start.clocks.of(calibrated)
    is_sure = bool(start.connected.all() and (start.support >= _SURE).all())
    solution = start
    for stage, part in enumerate((work.part(0.0, 0.4), work.part(0.4, 1.0))):
        found = fine_lags(rig, clocks, part) if stage else coarse_lags(rig, clocks, is_sure, part)
        numbered = [replace(lag, first=calibrated[lag.first], second=calibrated[lag.second]) for lag in found]
        reached = {film for lag in numbered for film in (lag.first, lag.second)}
        # Where nothing that moves is shared, the start is all there is.
        rest = [lag for lag in pairs if lag.source != "motion" and not {lag.first, lag.second} <= reached]
        pairs = numbered + rest
        solution = _solved(films, pairs)
        clocks = solution.clocks.of(calibrated)
    return pairs, solution


def _rivals(
    films: Sequence[Recording],
    rig: Rig,
    calibrated: Sequence[int],
    wide: Sequence[PairLag],
    solution: Solution,
    work: Work,
) -> dict[int, RunnerUp]:
    """Offsets far away that sound or motion energy leave open, and how well moving points agree with them."""
    frame, found = max(film.interval for film in films), {}
    for position, number in enumerate(calibrated):
        work.step("Looking for other offsets", position, len(calibrated))
        offset = float(solution.clocks.offsets[number])
        rival = runner_up(camera_curve(number, wide, solution.clocks, frame), offset, frame)
        if rival is None or not rival.is_as_likely:
            continue
        clocks = solution.clocks.of(calibrated)
        best, other = (score_at(rig, position, at, clocks) for at in (offset, rival.offset))
        if best > 0 and not isnan(other):
            found[number] = RunnerUp(rival.offset, other / best)
    return found
