"""Which image is of which camera, frame and time, for all cameras that stand still and for images of any times.

Films that are in step, of one constant rate, keep their frames' numbers. In all others an image belongs to the frame
nearest to its time, and keeps what is left as its offset; what nobody filmed stays a gap. Images in folders belong to
the times that the numbers in their names say (see ``frame_times``).
"""

import statistics
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from ...arrays import Float64s, Ints
from ...errors import FrogError, found_instead
from ..capture import Shot, with_a_time
from ..tone_mapping import NAMES
from ..video import VideoFacts
from .chapters import is_later_chapter
from .checks import check_fractions, check_images, frame_span
from .footage import RATE, Footage
from .frame_times import ROUNDING, counted_apart, frame_times, nearest_frames

_STAMP_ROUNDING = 0.00075  # seconds by which stamps of whole milliseconds, and cameras' own clocks, waver
_DRIFT = 0.05  # frames that two films in step may drift apart
_SAME_RATE = 0.0005  # relative difference of rates that nobody needs to be told
_CUT = 0.5  # of the longest film: a shorter one is hardly meant to decide what is used
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
        shots: cameras may lack images.
        frame_count: frames of the time that enough cameras show.
        frames_per_second: of the capture's time.
        warnings: one sentence each.
    """

    shots: Sequence[Shot]
    frame_count: int
    frames_per_second: float = RATE
    warnings: Sequence[str] = ()


def pair_footage(path: Path, footage: Sequence[Footage], clocks: Sequence[Clock] = ()) -> Pairing:
    """The images of standing cameras, of which camera i filmed ``footage[i]``, on frames that they share.

    Args:
        path: of the capture, for messages.
        clocks: of each camera's film; by default all start together, at the times that their files say.

    Raises:
        FrogError: if some are videos and some folders, they share no time, or a file cannot be used.
    """
    videos = [of_camera for of_camera in footage if of_camera.is_video]
    if videos and len(videos) < len(footage):
        folders = next(of_camera for of_camera in footage if not of_camera.is_video)
        found = f"the video {videos[0].name} and the folder of images {folders.name}"
        raise found_instead(path, found, "footage of one kind: all videos or all images")
    if videos:
        return pair_videos(path, videos, clocks)
    check_images(path, sum(len(of_camera.files) for of_camera in footage))
    check_fractions(path, ("/".join(file.parts[-2:]) for of_camera in footage for file in of_camera.files))
    images = [(camera, file) for camera, of_camera in enumerate(footage) for file in of_camera.files]
    counted, told = counted_apart(path, {of_camera.name: of_camera.numbers for of_camera in footage})
    pairing = pair_images(path, images, [number for of_camera in counted for number in of_camera])
    strays = sum(len(of_camera.strays) for of_camera in footage)
    warnings = [*filter(None, [told]), *pairing.warnings]
    warnings += [f"{path}: {strays} images that are named unlike the others are left out."] if strays else []
    warnings += gaps(path, pairing.shots, len(footage), pairing.frame_count)
    return replace(pairing, warnings=warnings)


def gaps(path: Path, shots: Sequence[Shot], cameras: int, count: int) -> Iterator[str]:
    """What standing cameras' images lack to be of all ``count`` frames."""
    filled = len({shot.frame for shot in shots})
    if missing := filled * cameras - len(shots):
        yield f"{path}: {missing:,} of {filled * cameras:,} images are missing; their places stay gaps."
    if filled < count:
        yield f"{path}: {count - filled:,} of {count:,} frames have no image and stay gaps."


def pair_images(path: Path, images: Sequence[tuple[int, Path]], numbers: Sequence[int]) -> Pairing:
    """Images, each a camera and a file, whose numbers, in their names or a list, are times.

    Raises:
        FrogError: for too many frames.
    """
    first = min(numbers)
    times = frame_times([float(number - first) for number in numbers], [camera for camera, _ in images], path)
    placed = zip(images, times.frames.tolist(), times.offsets.tolist(), strict=True)
    shots = [Shot(camera, frame, file, 0, offset) for (camera, file), frame, offset in placed]
    return Pairing(shots, times.count, warnings=times.warnings)


@dataclass(frozen=True, eq=False)
class _Film:
    """One video in the capture's time.

    Attributes:
        path: of the video.
        times: (N,) seconds of its images.
        rate: images a second, missing ones counted.
        missing: images that its times skip.
        is_steady: the images are as far apart as the rate says, up to rounding.
    """

    path: Path
    times: Float64s
    rate: float
    missing: int
    is_steady: bool


def pair_videos(path: Path, videos: Sequence[Footage], clocks: Sequence[Clock] = ()) -> Pairing:
    """Video i as camera i; see ``pair_footage``."""
    clocks = clocks or [Clock()] * len(videos)
    films = list(map(_film, videos, clocks))
    said = list(_said_of_images(videos))
    if _in_step(films):
        lengths = [len(film.times) for film in films]
        count, longest = min(lengths), max(lengths)
        frame_span(0, count - 1, path, "frames")
        check_images(path, count * len(films))
        if count < longest:
            hint = "" if count > longest * _CUT else ": take the shortest out, or put all of it there"
            shortest, other = (films[lengths.index(length)].path.name for length in (count, longest))
            said.append(
                f"{path}: the videos have different lengths ({shortest} {count} frames, {other} {longest}); the first "
                f"{count} frames are used{hint}."
            )
        images = ((camera, frame) for frame in range(count) for camera in range(len(videos)))
        shots = [Shot(camera, frame, *videos[camera].place(frame)) for camera, frame in images]
        return Pairing(shots, count, videos[0].facts.frames_per_second / clocks[0].rate, said)
    rate = statistics.median_low(film.rate for film in films)
    frames, offsets = zip(*_on_grid(films, rate), strict=True)
    first, last = _shared(frames)
    if any(of[0] > last or of[-1] < first for of in frames):
        raise _apart(path, films)
    count = frame_span(first, last, path, "frames")
    check_images(path, sum(min(count, len(of)) for of in frames))
    shots, crowded = [], []
    for camera, (film, of, late) in enumerate(zip(films, frames, offsets, strict=True)):
        inside = np.flatnonzero((of >= first) & (of <= last))
        chosen = _nearest(of, late, inside)
        crowded += [film.path] if len(chosen) < len(inside) else []
        shots += [
            Shot(camera, int(of[index]) - first, *videos[camera].place(int(index)), float(late[index]))
            for index in chosen
        ]
    warnings = [*said, *_said_of_times(path, films, by_their_files=set(clocks) == {Clock()})]
    if crowded:
        warnings.append(
            f"{path}: {_some(crowded)} took more images than {rate:g} a second, of which the nearest in time are used."
        )
    if any(of[0] < first or of[-1] > last for of in frames):
        warnings.append(
            f"{path}: the videos show different times; the {count} frames that at least {_quorum(len(films))} of them "
            "show are used."
        )
    return Pairing(with_a_time(shots, count), count, rate, warnings)


def _film(video: Footage, clock: Clock) -> _Film:
    path, times = video.files[0], clock.offset + clock.rate * video.facts.timestamps
    nominal = video.facts.frames_per_second / clock.rate
    steps = np.diff(times)
    if not (steps > 0).any():
        return _Film(path, times, nominal, 0, True)
    usual = np.median(steps[steps > 0])  # damaged files have frames at one time
    numbers = np.concatenate([[0], np.cumsum(np.maximum(np.round(steps / usual), 1))])
    tolerance = ROUNDING + _STAMP_ROUNDING * nominal
    missing = int(numbers[-1]) - (len(times) - 1)
    if np.abs((times - times[0]) * nominal - numbers).max() <= 2 * tolerance:  # the rate that the file says
        return _Film(path, times, nominal, missing, True)
    step = float(np.polyfit(numbers, times, 1)[0])
    off = (times - times.mean()) / step - (numbers - numbers.mean())
    return _Film(path, times, round(1 / step, 6), missing, bool(np.abs(off).max() <= tolerance))


def _in_step(films: Sequence[_Film]) -> bool:
    """Whether image k of every film was taken at one time."""
    first = films[0]
    length = max(len(film.times) for film in films)
    tolerance = ROUNDING + _STAMP_ROUNDING * first.rate
    return all(
        film.is_steady
        and not film.missing
        and abs(film.rate / first.rate - 1) * length <= _DRIFT
        and abs(film.times[0] - first.times[0]) * first.rate <= tolerance
        for film in films
    )


def _on_grid(films: Sequence[_Film], rate: float) -> list[tuple[Ints, Float64s]]:
    """Of each film's images the frames, and by how many frames they are late.

    The frames are where the images of one camera are: of the one that has the others' nearest to its own.
    """
    middles = np.array([film.times[len(film.times) // 2] * rate for film in films])
    apart = [middles - middle for middle in middles[:_CANDIDATES]]
    phase = middles[np.argmin([np.abs(off - np.round(off)).sum() for off in apart])] % 1
    return [nearest_frames(film.times * rate - phase) for film in films]


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


def _nearest(frames: Ints, late: Float64s, inside: Ints) -> Ints:
    """Of the images ``inside``, the nearest in time to each frame, ascending."""
    order = inside[np.lexsort((np.abs(late[inside]), frames[inside]))]
    _, first = np.unique(frames[order], return_index=True)
    return np.sort(order[first])


def said_of_films(path: Path, videos: Sequence[Footage]) -> list[str]:
    """What is unusual about films, whose starts are not known: one sentence each."""
    films = [_film(video, Clock()) for video in videos]
    times = [] if _in_step(films) else _said_of_times(path, films, by_their_files=False)
    return [*_said_of_images(videos), *times]


def _said_of_images(videos: Sequence[Footage]) -> Iterator[str]:
    """What is done to the films' images."""
    films: dict[str, list[Path]] = {}
    for video in videos:
        begun = ["begins with a later chapter: those before it are missing"] if is_later_chapter(video.files[0]) else []
        for said in (*_unusual(video.facts), *begun):
            films.setdefault(said, []).append(video.files[0])
    return (f"{of[0].parent}: {_some(of)} {said}." for said, of in films.items())


def _unusual(facts: VideoFacts) -> Iterator[str]:
    film = facts.header
    if film.transfer:
        yield f"is of high dynamic range ({NAMES[film.transfer]}) and is tone-mapped"
    if film.fields:
        yield "is interlaced: of the two times that each image shows the first is taken"
    if film.aspect != 1:
        yield "has pixels that are not square: images and lens are taken as wide as players show them"
    if film.is_untimed:
        yield f"says no times: its images are taken for {facts.frames_per_second:g} a second"
    if film.tracks > 1:
        yield "holds several films, as of two lenses, of which the first is used"


def _said_of_times(path: Path, films: Sequence[_Film], *, by_their_files: bool) -> Iterator[str]:
    """What is unusual about the films' times."""
    if skipping := [film.path for film in films if film.missing and film.is_steady]:
        missing = sum(film.missing for film in films if film.is_steady)
        yield f"{path}: {missing} frames of {_some(skipping)} are missing; images are paired by their times."
    if varying := [film.path for film in films if not film.is_steady]:
        yield f"{path}: the frame rate of {_some(varying)} varies; images are paired by their times."
    rates = [film.rate for film in films]
    if max(rates) > (1 + _SAME_RATE) * min(rates):
        yield (
            f"{path}: the videos' frame rates differ ({min(rates):.6g} to {max(rates):.6g} a second); images are "
            "paired by their times."
        )
    starts = [film.times[0] for film in films]
    late = max(starts) - min(starts)
    if by_their_files and late * max(rates) > ROUNDING + _STAMP_ROUNDING * max(rates):
        first, last = (films[starts.index(start)].path.name for start in (min(starts), max(starts)))
        yield f"{path}: {last} starts {late:.3f} s after {first}, as their files say."


def _some(videos: Iterable[Path]) -> str:
    """The first names, and how many more."""
    first, *others = [video.name for video in videos]
    return f"{first} (and {len(others)} more)" if others else first


def _apart(path: Path, films: Sequence[_Film]) -> FrogError:
    first, last = min(films, key=lambda film: film.times[-1]), max(films, key=lambda film: film.times[0])
    return FrogError(
        f"{path}: {first.path.name} ends at {first.times[-1]:.2f} s and {last.path.name} starts at {last.times[0]:.2f} "
        "s, expected films of the same time."
    )
