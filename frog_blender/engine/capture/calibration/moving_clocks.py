"""Clocks of moving cameras: by sound, else by timecode. What moves in their images is the cameras themselves."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import combinations

from ...io.child_process import Progress, Stopped
from ..media import film_tags
from ..synchronization.audio import audio_lag, read_audio
from ..synchronization.recordings import open_recording
from ..synchronization.report import reported
from ..synchronization.solve import solve
from ..synchronization.timecode import read_note
from .clocks import FoundClocks
from .films import Film

_DAY = 86_400.0


def find_moving_clocks(films: Sequence[Film], progress: Progress, cancelled: Callable[[], bool]) -> FoundClocks:
    """The films' clocks, and how they were found in a sentence.

    Raises:
        Stopped: if ``cancelled`` said so.
        FrogError: if a film cannot be decoded.
    """
    return _by_sound(films, progress, cancelled) or _by_timecode(films) or _none(films)


def _by_sound(films: Sequence[Film], progress: Progress, cancelled: Callable[[], bool]) -> FoundClocks | None:
    """By what all films hear; None where they do not, or the lags contradict each other."""
    opened, sounds = [open_recording(film.name, film.path) for film in films], []
    for place, film in enumerate(opened):
        progress("synchronisation", place, len(films))
        if cancelled():
            raise Stopped
        sound = read_audio(film)
        if sound is None:
            return None
        sounds.append(sound)
    lags = [audio_lag((one, other), (sounds[one], sounds[other])) for one, other in combinations(range(len(films)), 2)]
    pairs = [lag for lag in lags if lag is not None]
    solution = solve(len(opened), pairs, max(film.interval for film in opened), max(film.duration for film in opened))
    found = reported(opened, solution, pairs)
    if found.refusal is not None or not pairs:
        return None
    clocks = {camera.name: (camera.offset, camera.rate) for camera in found.cameras}
    sentence = "The films were synchronised by their sound alone, which is right to about a frame."
    return FoundClocks(clocks, None, (*found.warnings, sentence), found.to_json())


def _by_timecode(films: Sequence[Film]) -> FoundClocks | None:
    """By the timecodes that all films state; None where one does not."""
    starts = []
    for film in films:
        note = read_note(film_tags(film.path), film.facts.frames_per_second)
        if note is None or not note.is_timecode:
            return None
        starts.append(note.seconds - float(film.stamps[0]))
    first = starts[0]
    ahead = [(start - first + _DAY / 2) % _DAY - _DAY / 2 for start in starts]  # across midnight
    clocks = {film.name: (lag - min(ahead), 1.0) for film, lag in zip(films, ahead, strict=True)}
    return FoundClocks(clocks, None, ("The films were synchronised by their timecodes, which have whole frames.",))


def _none(films: Sequence[Film]) -> FoundClocks:
    sentence = (
        "Neither sound nor timecode tells when the films of moving cameras began: they were taken to be in step. If "
        "they are not, give their clocks (--clock CAMERA=SECONDS)."
    )
    return FoundClocks({film.name: (0.0, 1.0) for film in films}, None, (sentence,))
