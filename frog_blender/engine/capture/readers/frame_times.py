"""Frames of posed images, from the times that a list states or the numbers in their names; and their static cameras.

Times and numbers in equal steps become frames, and what is missing among them stays a gap. Times in no equal steps
belong to the frame that is nearest, and keep what is left as an offset.

Lists give every image a pose of its own, even those of videos from several static cameras (N3DV as 4D-GS's converter
writes it). Only in the images of a static camera is it known what changes.
"""

import math
import re
from collections.abc import Hashable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ...arrays import Float64s, Ints
from .checks import check_fractions, frame_span
from .readings import AUTO, CHOSEN, ONE_MOMENT, numbers_of, order_of, read_names

_FRAME_NUMBER = re.compile(r"[\W_]*\d*$")  # the end of what the names of a camera's images have in common
_OFF_GRID = 0.1  # steps by which a time may lie beside an equal step
ROUNDING = 0.02  # frames: an image this near to its frame's time was taken at it
_MOST_GAPS = 20  # frames for each time: more make no film
_FEW = 1000  # frames that any capture may have


@dataclass(frozen=True, eq=False)
class FrameTimes:
    """Of the images in the order of their times.

    Attributes:
        frames: (N,) the frame of each image, from 0.
        offsets: (N,) by how many frames it was later, -0.5 to 0.5.
        count: frames, of which the first is not later and the last not earlier than any image.
        warnings: one sentence where the times are too far apart for a film: the frames are their ranks alone.
    """

    frames: Ints
    offsets: Float64s
    count: int
    warnings: tuple[str, ...] = ()


def frame_times(times: Sequence[float], lists: Sequence[Hashable], path: Path) -> FrameTimes:
    """The frames of images.

    Args:
        times: of each image, in any unit.
        lists: which list names each image, the first one to train on. Images of one list at different times have
            different frames.

    Raises:
        FrogError: for too many frames.
    """
    distinct, rank = np.unique(np.asarray(times, np.float64), return_inverse=True)
    if len(distinct) == 1:
        return FrameTimes(np.zeros(len(rank), np.int64), np.zeros(len(rank)), 1)
    first = np.unique([time for time, of in zip(times, lists, strict=True) if of == lists[0]])
    for step in _steps(first, distinct):
        late = (distinct - first[0]) / step
        late -= min(np.floor(late[0] + ROUNDING), 0.0)
        if late[-1] > _FEW + _MOST_GAPS * len(distinct):
            continue
        frames, offsets = nearest_frames(late)
        if not _clash(frames[rank], rank, lists):
            count = frame_span(0, math.ceil(late[-1] - ROUNDING), path, "times of frames")
            return FrameTimes(frames[rank], offsets[rank], count)
    warnings = (f"{path}: the images' times are too far apart for a film; one follows the other.",)
    return FrameTimes(rank.astype(np.int64), np.zeros(len(rank)), len(distinct), warnings)


def nearest_frames(late: Float64s) -> tuple[Ints, Float64s]:
    """The frames nearest to times that count frames, and by how many frames each time is later."""
    frames = np.floor(late + 0.5).astype(np.int64)
    return frames, np.where(np.abs(late - frames) <= ROUNDING, 0.0, late - frames)


def _steps(first: Float64s, every: Float64s) -> Iterator[float]:
    """What may be the time from frame to frame, the likeliest first.

    Args:
        first: ascending times of the images to train on.
        every: of all images.
    """
    steps = [_equal_step(first) if len(first) > 1 else None, _equal_step(every)]
    yield from (step for step in steps if step is not None)
    own = np.diff(first if len(first) > 1 else every)
    yield from (float(np.median(own)), float(own.min()))


def _equal_step(times: Float64s) -> float | None:
    """The step of ascending times that lie in multiples of one; None where they do not."""
    steps = np.diff(times)
    whole = np.round(steps / np.median(steps[steps < 1.5 * steps.min()]))
    step = float((times[-1] - times[0]) / whole.sum())
    off = (times - times[0]) / step - np.concatenate([[0.0], np.cumsum(whole)])
    return step if np.abs(off).max() <= _OFF_GRID else None


def _clash(frames: Ints, times: Ints, lists: Sequence[Hashable]) -> bool:
    """Whether two images of one list have the same frame at different times."""
    first: dict[tuple[Hashable, int], int] = {}
    images = zip(lists, frames.tolist(), times.tolist(), strict=True)
    return any(first.setdefault((of, frame), time) != time for of, frame, time in images)


def times_by_name(path: Path, names: Sequence[str], views: Sequence[Hashable]) -> tuple[list[float], str]:
    """A time for each image of one list that states none, and a sentence if other times are as likely.

    Images of standing cameras, which equal views tell, follow each camera's own names: numbers (see ``counted_apart``)
    where all have some, else their order. Those of moving ones are as ``readings`` tell them.

    Args:
        path: of the list.
        names: paths as the list says them, of missing images, too.
        views: pose and lens of each image; equal where they are the same.

    Raises:
        FrogError: if the names of moving cameras' images can be read in several ways.
    """
    check_fractions(path, names)
    cameras: dict[Hashable, list[int]] = {}
    for index, view in enumerate(views):
        cameras.setdefault(view, []).append(index)
    if any(len(of) < 2 for of in cameras.values()):
        reading, told = read_names(path, names), f'{path}: no "time" says when images were taken; they are taken for'
        if reading.choice == ONE_MOMENT and CHOSEN.get() == AUTO and len(names) > 1:  # lists are of films
            ranks = numbers_of(names) or order_of(names)
            return [*map(float, ranks)], f"{told} one moving camera's, not for {reading}."
        return [*map(float, reading.times)], f"{told} {reading}." if reading.is_grid else reading.doubt
    named = {names[of[0]]: [names[index] for index in of] for of in cameras.values()}
    numbers = {first: numbers_of(own) for first, own in named.items()}
    if not all(numbers.values()):
        numbers = {first: order_of(own) for first, own in named.items()}
    counted, told = counted_apart(path, numbers)
    times = [0.0] * len(names)
    for of, own in zip(cameras.values(), counted, strict=True):
        for index, time in zip(of, own, strict=True):
            times[index] = float(time)
    return times, told


def counted_apart(path: Path, numbers: Mapping[str, Sequence[int]]) -> tuple[list[list[int]], str]:
    """The times of standing cameras' images that their numbers tell, and a sentence where counters of their own do:
    where cameras share no numbers with the others, theirs are counted from the first.

    Args:
        path: of the capture or the list.
        numbers: of each camera's images, by a name for it.
    """
    spans = {name: (min(own), max(own)) for name, own in numbers.items()}
    apart: list[str] = []
    firsts: dict[str, int] = {}
    end = -math.inf
    for name, (first, last) in sorted(spans.items(), key=lambda span: span[1]):
        apart += [name] if first > end else []
        firsts[name], end = spans[apart[-1]][0], max(end, last)
    if len(apart) < 2:
        return [[*own] for own in numbers.values()], ""
    one, *_, other = (f"{name} ({spans[name][0]} to {spans[name][1]})" for name in apart)
    told = f"{path}: the images of {one} and {other} share no numbers; each camera's are counted from its first."
    return [[number - firsts[name] for number in own] for name, own in numbers.items()], told


def first_images(views: Sequence[Hashable], times: Sequence[float]) -> list[int]:
    """For each image the index of its camera's first image.

    If every view was taken at several times, once at each, a view is one camera. Else every image is its own camera.

    Args:
        views: pose and lens of each image; equal where they are the same.
        times: of each image.
    """
    images: dict[Hashable, list[int]] = {}
    for index, view in enumerate(views):
        images.setdefault(view, []).append(index)
    if any(len(of) < 2 or len({times[index] for index in of}) < len(of) for of in images.values()):
        return list(range(len(views)))
    return [images[view][0] for view in views]


def camera_names(first: Sequence[int], names: Sequence[str]) -> list[str]:
    """The name of each image's camera: what the names of its images begin with (``cam00_0000``, ``cam00_0001``:
    cam00), or, where that tells no two cameras apart, its first image's.

    Args:
        first: see first_images.
        names: of each image, no two alike.
    """
    images: dict[int, list[str]] = {}
    for camera, name in zip(first, names, strict=True):
        images.setdefault(camera, []).append(name)
    common = {camera: _common(of) if len(of) > 1 else of[0] for camera, of in images.items()}
    if "" in common.values() or len({*common.values()}) < len(common):
        return [names[camera] for camera in first]
    return [common[camera] for camera in first]


def _common(names: Sequence[str]) -> str:
    first, last = min(names), max(names)  # what these two begin with, all do
    alike = next((index for index, (a, b) in enumerate(zip(first, last, strict=False)) if a != b), len(first))
    return _FRAME_NUMBER.sub("", first[:alike])
