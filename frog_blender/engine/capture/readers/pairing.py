"""Films of several cameras on one grid of frames, by the times at which their images were taken.

Films that are in step, of one constant rate, keep their frames' numbers. In all others an image belongs to the frame
nearest to its time, and keeps what is left as its offset; what nobody filmed stays a gap.
"""

from __future__ import annotations

import statistics
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ...arrays import Float64s, Ints
from ...errors import FrogError, found_instead
from ..capture import Shot, with_a_time
from ..tone_mapping import NAMES
from ..video import VideoFacts
from .checks import check_images, frame_span

_ROUNDING = 0.02  # frames: an image this near to its frame's time was taken at it
_STAMP_ROUNDING = 0.00075  # seconds by which stamps of whole milliseconds, and cameras' own clocks, waver
_DRIFT = 0.05  # frames that two films in step may drift apart
_SAME_RATE = 0.0005  # relative difference of rates that nobody needs to be told
_CANDIDATES = 64  # cameras whose images may be the grid's


@dataclass(frozen=True)
class Clock:
    """A camera's: the capture's time is ``offset`` + ``rate`` x the film's time.

    Attributes:
        offset: seconds after the capture's start at which the film starts.
        rate: seconds of the capture in a second of the film.
    """

    offset: float = 0.0
    rate: float = 1.0


@dataclass(frozen=True)
class Pairing:
    """Which image is of which camera and frame.

    Attributes:
        shots: camera i is of video i; cameras may lack images.
        frame_count: frames of the time that enough videos show.
        frames_per_second: of the capture's time.
        warnings: one sentence each.
    """

    shots: tuple[Shot, ...]
    frame_count: int
    frames_per_second: float
    warnings: list[str]


@dataclass(frozen=True, eq=False)
class _Film:
    """One video in the capture's time.

    Attributes:
        times: (N,) seconds of its images.
        rate: images a second, missing ones counted.
        missing: images that its times skip.
        is_steady: the images are as far apart as the rate says, up to rounding.
    """

    times: Float64s
    rate: float
    missing: int
    is_steady: bool

    @property
    def is_regular(self) -> bool:
        return self.is_steady and not self.missing


def pair_videos(
    path: Path, videos: Sequence[Path], facts: Sequence[VideoFacts], clocks: Sequence[Clock] | None = None
) -> Pairing:
    """Video i as camera i of one capture.

    Args:
        path: of the capture, for messages.
        clocks: of each camera; by default all films start together, at the times that their files say.

    Raises:
        FrogError: if the videos share no time, or there are too many frames or images.
    """
    films = [_film(fact, clock) for fact, clock in zip(facts, clocks or [Clock()] * len(facts), strict=True)]
    said = _said_of_images(videos, facts)
    if _in_step(films):
        count, warnings = _shared_frame_count(path, videos, facts)
        rate = facts[0].frames_per_second if clocks is None else films[0].rate
        return Pairing(_shots_of_videos(videos, count), count, rate, said + warnings)
    rate = statistics.median_low(film.rate for film in films)
    frames, offsets = _on_grid(films, rate)
    first, last = _shared(frames)
    if any(of[0] > last or of[-1] < first for of in frames):
        raise _apart(path, videos, films)
    count = frame_span(first, last, path, "frames")
    check_images(path, sum(min(count, len(of)) for of in frames))
    shots: list[Shot] = []
    crowded = []
    for camera, (of, late) in enumerate(zip(frames, offsets, strict=True)):
        inside = np.flatnonzero((of >= first) & (of <= last))
        chosen = _nearest(of, late, inside)
        crowded += [videos[camera]] if len(chosen) < len(inside) else []
        shots += [
            Shot(camera, int(of[index]) - first, videos[camera], int(index), float(late[index])) for index in chosen
        ]
    warnings = said + _warnings(path, videos, films, clocks is None)
    if crowded:
        warnings.append(
            f"{path}: {_some(crowded)} took more images than {rate:g} a second, of which the nearest in time are used."
        )
    if any(of[0] < first or of[-1] > last for of in frames):
        warnings.append(
            f"{path}: the videos show different times; the {count} frames that at least {_quorum(len(films))} of them "
            "show are used."
        )
    return Pairing(tuple(with_a_time(shots, count)), count, rate, warnings)


def _film(fact: VideoFacts, clock: Clock) -> _Film:
    times = clock.offset + clock.rate * fact.timestamps
    nominal = fact.frames_per_second / clock.rate
    steps = np.diff(times)
    if not (steps > 0).any():
        return _Film(times, nominal, 0, True)
    usual = np.median(steps[steps > 0])  # damaged files have frames at one time
    numbers = np.concatenate([[0], np.cumsum(np.maximum(np.round(steps / usual), 1))])
    tolerance = _ROUNDING + _STAMP_ROUNDING * nominal
    missing = int(numbers[-1]) - (len(times) - 1)
    if np.abs((times - times[0]) * nominal - numbers).max() <= 2 * tolerance:  # the rate that the file says
        return _Film(times, nominal, missing, True)
    step = float(np.polyfit(numbers, times, 1)[0])
    off = (times - times.mean()) / step - (numbers - numbers.mean())
    return _Film(times, round(1 / step, 6), missing, bool(np.abs(off).max() <= tolerance))


def _in_step(films: Sequence[_Film]) -> bool:
    """Whether image k of every film was taken at one time."""
    first = films[0]
    length = max(len(film.times) for film in films)
    tolerance = _ROUNDING + _STAMP_ROUNDING * first.rate
    return all(
        film.is_regular
        and abs(film.rate / first.rate - 1) * length <= _DRIFT
        and abs(film.times[0] - first.times[0]) * first.rate <= tolerance
        for film in films
    )


def _shared_frame_count(path: Path, videos: Sequence[Path], facts: Sequence[VideoFacts]) -> tuple[int, list[str]]:
    """Number of frames that all synchronised videos have, and warnings if their lengths or rates differ.

    Raises:
        FrogError: if a video has no frame, or there are too many frames or images.
    """
    counts = [fact.frame_count for fact in facts]
    shared = min(counts)
    if shared < 1:
        raise found_instead(videos[counts.index(shared)], "no frame", "videos that share at least one frame")
    frame_span(0, shared - 1, path, "frames")
    check_images(path, shared * len(videos))
    warnings = []
    if shared != max(counts):
        shortest, longest = videos[counts.index(shared)].name, videos[counts.index(max(counts))].name
        warnings.append(
            f"{path}: the videos have different lengths ({shortest} {shared} frames, {longest} {max(counts)}); "
            f"the first {shared} frames are used."
        )
    rates = [fact.frames_per_second for fact in facts]
    if max(rates) > 1.02 * min(rates):
        warnings.append(f"{path}: the videos' frame rates differ ({min(rates):g} to {max(rates):g} a second).")
    return shared, warnings


def _shots_of_videos(videos: Sequence[Path], frame_count: int) -> tuple[Shot, ...]:
    """The images of all videos, where video i is of camera i."""
    return tuple(Shot(c, f, video, f) for f in range(frame_count) for c, video in enumerate(videos))


def _on_grid(films: Sequence[_Film], rate: float) -> tuple[list[Ints], list[Float64s]]:
    """Of each film's images the frames, and by how many frames they are late.

    The frames are where the images of one camera are: of the one that has the others' nearest to its own.
    """
    middles = np.array([film.times[len(film.times) // 2] * rate for film in films])
    apart = [np.abs(_wrapped(middles - middle)).sum() for middle in middles[:_CANDIDATES]]
    phase = middles[int(np.argmin(apart))] % 1
    positions = [film.times * rate - phase for film in films]
    frames = [np.floor(position + 0.5).astype(np.int64) for position in positions]
    late = [position - frame for position, frame in zip(positions, frames, strict=True)]
    return frames, [np.where(np.abs(of) <= _ROUNDING, 0.0, of) for of in late]


def _quorum(films: int) -> int:
    """Films that must show a time that is used: two, since one view tells no depth, and half of all."""
    return min(films, max(2, (films + 1) // 2))


def _shared(frames: Sequence[Ints]) -> tuple[int, int]:
    """The first and the last frame of the longest time that enough films show; the last before the first for none."""
    changes = sorted([(int(of[0]), 1) for of in frames] + [(int(of[-1]) + 1, -1) for of in frames])
    quorum, shown, start, longest = _quorum(len(frames)), 0, 0, (0, -1)
    for frame, change in changes:
        shown += change
        if change > 0 and shown == quorum:
            start = frame
        elif change < 0 and shown == quorum - 1 and frame - 1 - start > longest[1] - longest[0]:
            longest = start, frame - 1
    return longest


def _wrapped(frames: Float64s) -> Float64s:
    """The part of a frame by which positions differ, of -0.5 to 0.5."""
    part: Float64s = frames - np.round(frames)
    return part


def _nearest(frames: Ints, late: Float64s, inside: Ints) -> Ints:
    """Of the images ``inside``, the nearest in time to each frame, ascending."""
    order = inside[np.lexsort((np.abs(late[inside]), frames[inside]))]
    _, first = np.unique(frames[order], return_index=True)
    return np.sort(order[first])


def _said_of_images(videos: Sequence[Path], facts: Sequence[VideoFacts]) -> list[str]:
    """What is done to the films' images."""
    warnings = []
    for transfer, name in NAMES.items():
        films = [video for video, fact in zip(videos, facts, strict=True) if fact.transfer == transfer]
        if films:
            warnings.append(f"{films[0].parent}: {_some(films)} is of high dynamic range ({name}) and is tone-mapped.")
    if films := [video for video, fact in zip(videos, facts, strict=True) if fact.is_interlaced]:
        warnings.append(
            f"{films[0].parent}: {_some(films)} is interlaced: each image shows two times, a line of one and a line of "
            "the other. Deinterlace it first (ffmpeg's filter bwdif)."
        )
    return warnings


def _warnings(path: Path, videos: Sequence[Path], films: Sequence[_Film], by_their_files: bool) -> list[str]:
    """What is unusual about the films' times."""
    warnings = []
    named = list(zip(videos, films, strict=True))
    if skipping := [video for video, film in named if film.missing and film.is_steady]:
        missing = sum(film.missing for film in films if film.is_steady)
        warnings.append(f"{path}: {missing} frames of {_some(skipping)} are missing; images are paired by their times.")
    if varying := [video for video, film in named if not film.is_steady]:
        warnings.append(f"{path}: the frame rate of {_some(varying)} varies; images are paired by their times.")
    rates = [film.rate for film in films]
    if max(rates) > (1 + _SAME_RATE) * min(rates):
        warnings.append(
            f"{path}: the videos' frame rates differ ({min(rates):.6g} to {max(rates):.6g} a second); images are "
            "paired by their times."
        )
    starts = [float(film.times[0]) for film in films]
    if by_their_files and (max(starts) - min(starts)) * max(rates) > _ROUNDING + _STAMP_ROUNDING * max(rates):
        latest, earliest = videos[int(np.argmax(starts))].name, videos[int(np.argmin(starts))].name
        warnings.append(
            f"{path}: {latest} starts {max(starts) - min(starts):.3f} s after {earliest}, as their files say."
        )
    return warnings


def _some(videos: Iterable[Path]) -> str:
    """The first names, and how many more."""
    first, *others = [video.name for video in videos]
    return f"{first} (and {len(others)} more)" if others else first


def _apart(path: Path, videos: Sequence[Path], films: Sequence[_Film]) -> FrogError:
    ends = int(np.argmin([film.times[-1] for film in films]))
    starts = int(np.argmax([film.times[0] for film in films]))
    return FrogError(
        f"{path}: {videos[ends].name} ends at {films[ends].times[-1]:.2f} s and {videos[starts].name} starts at "
        f"{films[starts].times[0]:.2f} s, expected films of the same time."
    )
