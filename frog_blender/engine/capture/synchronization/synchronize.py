"""Raw films of several cameras to one clock a camera: by sound, else by named points or motion; then moving points."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from itertools import combinations
from math import isnan
from pathlib import Path

from ..camera import Camera
from ..capture import Distortion
from ..media import film_tags
from . import limits
from .motion import Rig, coarse_lags, find_points, fine_lags, score_at, straightened
from .moving_points import MovingPoints
from .pairs import PairLag, Solution, solve
from .recordings import Motion, Recording, motion_of, open_recording
from .report import camera_curve, reported, runner_up
from .starts import audio_lag, energy_lag, preferred, read_audio, read_timecode
from .synchronization import RunnerUp, Synchronization
from .tracks import NamedTracks, track_lags
from .work import Kept, Progress, Work, forward_only, in_threads


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

    Sound comes first: where it joins all films, nothing else is asked but moving points, which measure closer.

    Args:
        films: a video for each camera's name.
        cameras: where known, the answer is right to a few hundredths of a frame; at the films' sizes or others of the
            same proportions.
        distortions: of the cameras' lenses.
        tracks: points known by name in all films, as a person's joints are, in pixels of the films as stored: asked
            in place of motion where sound does not tell and views may have nothing else alike. With none of them sound
            alone is asked, as of cameras that move: what moves in their images is themselves.
        progress, cancelled: see work.Work; asked and told from several threads.
        kept: keeps what a second synchronisation of the same films needs again.

    Raises:
        FrogError: if a film cannot be decoded.
        Stopped: if the user ended it.
    """
    work = Work(forward_only(progress), cancelled)
    opened = [open_recording(name, path) for name, path in films.items()]
    if len(opened) < 2:
        return reported(opened, solve(len(opened), [], 1.0, 1.0), [])
    known = {
        i: cameras[film.name].resized(film.width, film.height)
        for i, film in enumerate(opened)
        if cameras is not None and film.name in cameras
    }
    pairs = _heard(opened, work.part(0.0, 0.1))
    is_heard = bool(_solved(opened, pairs).connected.all())
    motions: list[Motion] = []
    if len(known) > 1 or not (is_heard or tracks is not None):
        parts = work.part(0.1, 0.4).parts(len(opened))
        motions = in_threads(lambda film: motion_of(opened[film], parts[film], kept), range(len(opened)))
    if not is_heard and tracks:
        width = max(film.width for film in opened)
        pairs = track_lags([tracks[film.name] for film in opened], width)
    elif not is_heard and tracks is None:
        pairs += _alike(opened, motions, {(pair.first, pair.second) for pair in pairs})
    solution, rivals = _solved(opened, pairs), {}
    if len(known) > 1:
        rig = _rig(opened, motions, known, distortions or {}, solution, work.part(0.4, 0.7), kept=kept)
        refined, solution = _refined(rig, pairs, solution, work.part(0.7, 0.95))
        rivals = _rivals(rig, pairs, solution, work.part(0.95, 1.0))
        pairs = refined
    work.step("Synchronised", 1, 1)
    return reported(opened, solution, pairs, rivals)


def _solved(films: Sequence[Recording], pairs: Sequence[PairLag]) -> Solution:
    frame = max(film.interval for film in films)
    return solve(len(films), pairs, frame, max(film.duration for film in films))


def _heard(films: Sequence[Recording], work: Work) -> list[PairLag]:
    """Lags of the films that sound alike."""
    sounds = []
    for index, film in enumerate(films):
        work.step(f"Listening to {film.name}", index, len(films))
        sounds.append(read_audio(film))
    lags = []
    for first, second in combinations(range(len(films)), 2):
        one, other = sounds[first], sounds[second]
        lag = None if one is None or other is None else audio_lag((first, second), (one, other))
        lags += [] if lag is None else [lag]
    return lags


def _alike(films: Sequence[Recording], motions: Sequence[Motion], heard: set[tuple[int, int]]) -> list[PairLag]:
    """Lags of the other films, by how much moves in them; a timecode chooses between several."""
    codes = [read_timecode(film_tags(film.path), 1 / film.interval) for film in films]
    lags = []
    for pair in combinations(range(len(films)), 2):
        if pair in heard:
            continue
        first, second = pair
        step = min(films[first].interval, films[second].interval)
        lag = energy_lag(pair, (motions[first].energy, motions[second].energy), step)
        lags += [] if lag is None else [preferred(lag, codes[first], codes[second])]
    return lags


def _rig(
    films: Sequence[Recording],
    motions: Sequence[Motion],
    cameras: Mapping[int, Camera],
    distortions: Mapping[str, Distortion | None],
    start: Solution,
    work: Work,
    *,
    kept: Kept | None,
) -> Rig:
    """The films whose cameras are known, with their moving points."""
    parts = dict(zip(cameras, work.parts(len(cameras)), strict=True))

    def points_of(film: int) -> MovingPoints:
        points = find_points(films[film], motions[film], start.clocks, film, parts[film], kept)
        straight = straightened(cameras[film], distortions.get(films[film].name), points.tracks)
        return replace(points, tracks=straight)

    return Rig(films, cameras, dict(zip(cameras, in_threads(points_of, cameras), strict=True)))


def _refined(rig: Rig, pairs: Sequence[PairLag], start: Solution, work: Work) -> tuple[list[PairLag], Solution]:
    """Lags of moving points in place of the start's, for the films whose cameras are known."""
    is_sure = bool(start.connected.all() and (start.support >= limits.SURE).all())
    lags = coarse_lags(rig, start.clocks, is_sure, work.part(0.0, 0.4))
    refined = _joined(lags, pairs)
    lags = fine_lags(rig, _solved(rig.films, refined).clocks, work.part(0.4, 1.0))
    refined = _joined(lags, pairs)
    return refined, _solved(rig.films, refined)


def _joined(lags: list[PairLag], pairs: Sequence[PairLag]) -> list[PairLag]:
    """Lags of moving points, and the start's of films that share nothing that moves."""
    reached = {film for lag in lags for film in (lag.first, lag.second)}
    return lags + [pair for pair in pairs if not {pair.first, pair.second} <= reached]


def _rivals(rig: Rig, wide: Sequence[PairLag], solution: Solution, work: Work) -> dict[int, RunnerUp]:
    """Offsets far away that sound or motion energy leave open, and how well moving points agree with them."""
    frame, rivals = max(film.interval for film in rig.films), {}
    for index, film in enumerate(rig.cameras):
        work.step("Looking for other offsets", index, len(rig.cameras))
        offset = float(solution.clocks.offsets[film])
        rival = runner_up(camera_curve(film, wide, solution.clocks, frame), offset, frame)
        if rival is None or not rival.is_as_likely:
            continue
        best, other = (score_at(rig, film, at, solution.clocks) for at in (offset, rival.offset))
        if best > 0 and not isnan(other):
            rivals[film] = RunnerUp(rival.offset, other / best)
    return rivals
