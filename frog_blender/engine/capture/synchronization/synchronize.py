"""Raw films of several cameras to one clock a camera: by sound, else by named points or motion; then moving points."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import combinations

import numpy as np

from ...arrays import Float32s
from ...errors import FrogError, found_instead
from ...io.child_process import Progress
from ...io.work_folder import WorkFolder
from ..video import load_opencv
from . import limits
from .films import Film
from .motion import Cameras, coarse_lags, fine_lags, views_of
from .pairs import PairLag, Solution, solve
from .run import Run
from .starts import Motion, audio_lag, energy_lag, motion_of, preferred, read_audio, read_timecode
from .synchronization import Synchronization, in_step, reported
from .tracks import NamedTracks, track_lags


def find_clocks(
    run: Run, films: Sequence[Film], cameras: Cameras | None = None, tracks: Mapping[str, NamedTracks] | None = None
) -> Synchronization:
    """``synchronize`` in a process of its own; films that began together and ran alike have equal clocks.

    Raises:
        Stopped: if the run was cancelled.
        FrogError: if a film cannot be decoded, or the process of the synchronisation died.
    """
    return in_step(run.in_child(synchronize, films, run.work, cameras, tracks), films)


def synchronize(
    films: Sequence[Film],
    work: WorkFolder,
    cameras: Cameras | None = None,
    tracks: Mapping[str, NamedTracks] | None = None,
    tell: Progress = lambda stage, done, total: None,
) -> Synchronization:
    """The offset and the rate of every camera's clock, whatever the films' are taken to be.

    Sound comes first: where it joins all films, nothing else is asked but moving points, which measure closer.

    Args:
        work: keeps what is found in each film.
        cameras: of all films, where known: the answer is right to a few hundredths of a frame. At the films' sizes or
            others of the same proportions.
        tracks: points known by name in all films, as a person's joints are, in pixels of the films as stored: asked
            in place of motion where sound does not tell and views may have nothing else alike. With none of them sound
            alone is asked, as of cameras that move: what moves in their images is themselves.
        tell: told a stage's name, and how much of how much is done.

    Raises:
        FrogError: if a film cannot be decoded, or has fewer than three frames.
    """
    load_opencv().setNumThreads(1)  # films and pairs of them share the processors
    run = Run(work, tell, lambda: False)
    for film in films:
        if film.facts.frame_count < 3:
            found = f"a video of {film.facts.frame_count} frames"
            raise found_instead(film.path, found, "at least three, in which something moves")
    if len(films) < 2:
        return reported(films, _solved(films, []), [])
    pairs, unheard = _heard(films, run)
    is_heard = bool(_solved(films, pairs).connected.all())
    motions: list[Motion] = []
    if cameras or not (is_heard or tracks is not None):
        motions = run.in_threads("motion", lambda film: motion_of(film, run.work), films)
    if not is_heard and tracks:
        pairs = track_lags([tracks[film.name] for film in films], max(film.size[0] for film in films))
    elif not is_heard and tracks is None:
        pairs += _alike(films, motions, {(pair.first, pair.second) for pair in pairs})
    solution = _solved(films, pairs)
    if cameras:
        is_sure = bool(solution.connected.all() and (solution.support >= limits.SURE).all())
        views = views_of(films, motions, cameras, solution.clocks, run)
        coarse = _joined(coarse_lags(views, solution.clocks, is_sure, run), pairs)
        pairs = _joined(fine_lags(views, _solved(films, coarse).clocks, run), pairs)
        solution = _solved(films, pairs)
    answer = reported(films, solution, pairs)
    return replace(answer, warnings=(*unheard, *answer.warnings))


def _solved(films: Sequence[Film], pairs: Sequence[PairLag]) -> Solution:
    frame = max(film.interval for film in films)
    return solve(len(films), pairs, frame, max(film.duration for film in films))


def _heard(films: Sequence[Film], run: Run) -> tuple[list[PairLag], list[str]]:
    """Lags of the films that sound alike, and a warning about each film that has sound which cannot be read."""
    sounds = run.in_threads("sound", _sound_of, films)
    pairs = combinations(((index, sound) for index, sound in enumerate(sounds) if isinstance(sound, np.ndarray)), 2)
    lags = [audio_lag((first, second), (one, other)) for (first, one), (second, other) in pairs]
    unheard = [f"The clocks are found without the sound of {sound}" for sound in sounds if isinstance(sound, str)]
    return [lag for lag in lags if lag is not None], unheard


def _sound_of(film: Film) -> Float32s | str | None:
    """Its samples; which film and why, where there is sound that cannot be read; None where there is none."""
    try:
        return read_audio(film)
    except FrogError as error:
        return f"{film.name}. {error}"


def _alike(films: Sequence[Film], motions: Sequence[Motion], heard: set[tuple[int, int]]) -> Iterator[PairLag]:
    """Lags of the other films, by how much moves in them; a timecode chooses between several."""
    codes = [read_timecode(film) for film in films]
    energies = [(motion.times, motion.energies) for motion in motions]
    for first, second in combinations(range(len(films)), 2):
        if (first, second) not in heard:
            step = min(films[first].interval, films[second].interval)
            lag = energy_lag((first, second), (energies[first], energies[second]), step)
            if lag is not None:
                yield preferred(lag, (codes[first], codes[second]))


def _joined(lags: list[PairLag], pairs: Sequence[PairLag]) -> list[PairLag]:
    """Lags of moving points, and the start's of films that share nothing that moves."""
    reached = {film for lag in lags for film in (lag.first, lag.second)}
    return lags + [pair for pair in pairs if not {pair.first, pair.second} <= reached]
