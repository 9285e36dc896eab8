"""Raw films of several cameras to one clock a camera: by sound, else by named points or motion; then moving points."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import combinations

from ...errors import found_instead
from ...io.child_process import Progress
from ..camera import Camera
from ..capture import Distortion
from ..video import load_opencv
from . import limits
from .films import Film
from .motion import Rig, coarse_lags, find_points, fine_lags, straightened
from .moving_points import MovingPoints
from .pairs import PairLag, Solution, solve
from .report import reported
from .run import Run, WorkFolder
from .starts import Motion, audio_lag, energy_lag, motion_of, preferred, read_audio, read_timecode
from .synchronization import Synchronization, in_step
from .tracks import NamedTracks, track_lags

Cameras = Mapping[str, tuple[Camera, Distortion | None]]
"""Cameras that are known, by name, with their lenses' distortion."""


def synchronize(
    films: Sequence[Film], run: Run, cameras: Cameras | None = None, tracks: Mapping[str, NamedTracks] | None = None
) -> Synchronization:
    """The offset and the rate of every camera's clock, whatever the films' are taken to be.

    Sound comes first: where it joins all films, nothing else is asked but moving points, which measure closer.

    Args:
        cameras: where known, the answer is right to a few hundredths of a frame; at the films' sizes or others of the
            same proportions.
        tracks: points known by name in all films, as a person's joints are, in pixels of the films as stored: asked
            in place of motion where sound does not tell and views may have nothing else alike. With none of them sound
            alone is asked, as of cameras that move: what moves in their images is themselves.

    Raises:
        FrogError: if a film cannot be decoded, or has fewer than three frames.
        Stopped: if the user ended it.
    """
    for film in films:
        if film.facts.frame_count < 3:
            found = f"a video of {film.facts.frame_count} frames"
            raise found_instead(film.path, found, "at least three, in which something moves")
    if len(films) < 2:
        return reported(films, solve(len(films), [], 1.0, 1.0), [])
    known = {index: (cameras or {})[film.name] for index, film in enumerate(films) if film.name in (cameras or {})}
    pairs = _heard(films, run)
    is_heard = bool(_solved(films, pairs).connected.all())
    motions: list[Motion] = []
    if len(known) > 1 or not (is_heard or tracks is not None):
        motions = run.in_threads("motion", lambda film: motion_of(film, run), films)
    if not is_heard and tracks:
        pairs = track_lags([tracks[film.name] for film in films], max(film.size[0] for film in films))
    elif not is_heard and tracks is None:
        pairs += _alike(films, motions, {(pair.first, pair.second) for pair in pairs})
    solution = _solved(films, pairs)
    if len(known) > 1:
        pairs, solution = _refined(_rig(films, motions, known, solution, run), pairs, solution, run)
    return reported(films, solution, pairs)


def find_clocks(
    run: Run, films: Sequence[Film], cameras: Cameras | None = None, tracks: Mapping[str, NamedTracks] | None = None
) -> Synchronization:
    """The films' clocks, by sound, by points known by name, or by motion and moving points, in a process of its own.

    Args:
        cameras: that are known, by name.
        tracks: points that have the same names in all films, as a person's joints have.

    Raises:
        Stopped: if the run was cancelled.
        FrogError: if a film cannot be decoded, or the process of the synchronisation died.
    """
    return in_step(run.in_child(synchronized, films, cameras, tracks, run.work), films)


def synchronized(
    films: Sequence[Film],
    cameras: Cameras | None,
    tracks: Mapping[str, NamedTracks] | None,
    work: WorkFolder,
    tell: Progress,
) -> Synchronization:
    """``synchronize`` in the child, whose matrix library has one thread, for the matrices are small."""
    load_opencv().setNumThreads(1)  # films and pairs of them share the processors
    return synchronize(films, Run(work, tell, lambda: False), cameras, tracks)


def _solved(films: Sequence[Film], pairs: Sequence[PairLag]) -> Solution:
    frame = max(film.interval for film in films)
    return solve(len(films), pairs, frame, max(film.duration for film in films))


def _heard(films: Sequence[Film], run: Run) -> list[PairLag]:
    """Lags of the films that sound alike."""
    sounds = run.in_threads("sound", read_audio, films)
    lags = []
    for first, second in combinations(range(len(films)), 2):
        run.check()
        one, other = sounds[first], sounds[second]
        lag = None if one is None or other is None else audio_lag((first, second), (one, other))
        lags += [] if lag is None else [lag]
    return lags


def _alike(films: Sequence[Film], motions: Sequence[Motion], heard: set[tuple[int, int]]) -> list[PairLag]:
    """Lags of the other films, by how much moves in them; a timecode chooses between several."""
    codes = [read_timecode(film) for film in films]
    lags = []
    for first, second in combinations(range(len(films)), 2):
        if (first, second) in heard:
            continue
        step = min(films[first].interval, films[second].interval)
        lag = energy_lag((first, second), (motions[first].energy, motions[second].energy), step)
        lags += [] if lag is None else [preferred(lag, (codes[first], codes[second]))]
    return lags


def _rig(
    films: Sequence[Film],
    motions: Sequence[Motion],
    known: Mapping[int, tuple[Camera, Distortion | None]],
    start: Solution,
    run: Run,
) -> Rig:
    """The films whose cameras are known, with their moving points."""
    cameras = {index: camera.resized(*films[index].size) for index, (camera, _) in known.items()}

    def points_of(index: int) -> MovingPoints:
        points = find_points(films[index], motions[index], start.clocks, index, run)
        return replace(points, tracks=straightened(cameras[index], known[index][1], points.tracks))

    points = run.in_threads("moving points", points_of, cameras)
    return Rig(films, cameras, dict(zip(cameras, points, strict=True)))


def _refined(rig: Rig, pairs: Sequence[PairLag], start: Solution, run: Run) -> tuple[list[PairLag], Solution]:
    """Lags of moving points in place of the start's, for the films whose cameras are known."""
    is_sure = bool(start.connected.all() and (start.support >= limits.SURE).all())
    coarse = _solved(rig.films, _joined(coarse_lags(rig, start.clocks, is_sure, run), pairs))
    refined = _joined(fine_lags(rig, coarse.clocks, run), pairs)
    return refined, _solved(rig.films, refined)


def _joined(lags: list[PairLag], pairs: Sequence[PairLag]) -> list[PairLag]:
    """Lags of moving points, and the start's of films that share nothing that moves."""
    reached = {film for lag in lags for film in (lag.first, lag.second)}
    return lags + [pair for pair in pairs if not {pair.first, pair.second} <= reached]
