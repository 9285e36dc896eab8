"""What calibration looks at in a standing camera's film: its background, where something moves, and some images."""

import re
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import pairwise
from typing import Any

import numpy as np

from ...arrays import Array, Bools, ImageArray, Ints
from ...errors import FrogError, found_instead
from ...io.work_folder import WorkFolder, key_of
from ..readers.readings import AUTO, MOVING
from ..synchronization.films import Film, Run, kinds_of, spread
from ..video import load_opencv

STANDING = "standing"
"""Of films, beside what ``readings`` calls names: their cameras stand, whatever moves before them."""
WALK_THROUGH = re.compile(r"scan(_.*)?", re.IGNORECASE)
"""The names of walk-throughs."""
LONGEST_SIDE = 1600
"""Pixels of the images that features are sought in: more of them cost time and win nothing."""
_BACKGROUND_IMAGES = 30
_BACKGROUND_FRAMES = 1200  # frames from the start among which they are spread: all before the last one are decoded
_CHANGES = 6.0  # of 255: standard deviation over time of what moves
_STILL = 2.5  # pixels that the background of a standing camera moves by, at 500 pixels of width: webcams shake
_STILL_SHARE = 0.1  # of the corners: people and boards may cover the rest, and of a moving camera none stays
_CELLS, _CORNERS = 8, 6  # of the image's width and height, and corners of each: a board has the strongest ones
_LEAST_CELLS = 0.3  # that have corners: fewer are what somebody holds before a dark cloth
_MOST_DECODED = 4  # films at once: of each some dozens of images are held


@dataclass(frozen=True, eq=False)
class View:
    """One standing camera's film as calibration sees it.

    Attributes:
        background: (h, w) uint8 brightness of the background: the median over time, at most LONGEST_SIDE a side.
        changing: (h, w) bool, where something moves.
        images: (K, h, w) brightness like ``background``, those nearest to common times.
        moments: (K,) int64 which of the times; the film has no images at the others.
    """

    background: ImageArray
    changing: Bools
    images: ImageArray
    moments: Ints


@dataclass(frozen=True)
class CameraFacts:
    """What is known of a standing camera before its calibration.

    Attributes:
        name, width, height: of its film, pixels.
        group: cameras of one group are of one kind and share their focal length.
        key: of the work folder's stage "view", where its view is kept; else "".
    """

    name: str
    width: int
    height: int
    group: int = 0
    key: str = ""

    @property
    def size(self) -> tuple[int, int]:
        """Width and height in pixels."""
        return self.width, self.height

    @property
    def side(self) -> int:
        """Pixels of the longer side."""
        return max(self.size)

    def view(self, work: WorkFolder) -> View:
        """Its view; FrogError where it is not there, or not as it was."""
        arrays = work.load("view", self.key)
        if arrays is None:
            raise found_instead(work.file("view", self.key), "a damaged view, or none", "what calibration kept there")
        return View(**arrays)


def facts_of(films: Sequence[Film]) -> list[CameraFacts]:
    """What films say of their cameras."""
    return [CameraFacts(film.name, *film.size, group) for film, group in zip(films, kinds_of(films), strict=True)]


def views_of(run: Run, films: Sequence[Film], count: int = 0) -> list[CameraFacts]:
    """The same with the films' backgrounds and what moves at so many common times, kept in the work folder."""
    times = common_times(films, count) if count else []

    def of_film(film: Film) -> str:
        key = key_of(film.state, [round(film.frame_at(time)) for time in times])
        run.work.kept("view", key, lambda: vars(view_film(film, times, run.check)))
        return key

    keys = run.in_threads("images", of_film, films, _MOST_DECODED)
    return [replace(facts, key=key) for facts, key in zip(facts_of(films), keys, strict=True)]


def standing_of(run: Run, films: Sequence[Film], layout: str = AUTO) -> list[bool]:
    """Whether each film's background rests between its first, middle and last image; of an earlier run or new.

    Or as ``layout`` says: then those named walk-throughs move.
    """
    if layout in (MOVING, STANDING):
        return [layout != MOVING and not WALK_THROUGH.fullmatch(film.name) for film in films]

    def of_film(film: Film) -> bool:
        run.check()
        kept = run.work.kept("standing", key_of(film.state), lambda: {"standing": np.array(_rests(film))})
        return bool(kept["standing"])

    return run.in_threads("films", of_film, films, _MOST_DECODED)


def _rests(film: Film) -> bool:
    cv2 = load_opencv()
    last = min(film.facts.frame_count, _BACKGROUND_FRAMES) - 1
    first, *others = film.gray(sorted({0, last // 2, last}), LONGEST_SIDE)
    cells = list(_corners(first)) if others else []
    if len(cells) < _LEAST_CELLS * _CELLS**2:
        return True
    corners = np.concatenate(cells)
    still = max(1.0, _STILL * first.shape[1] / 500)
    for other in others:
        ends, is_tracked, _ = cv2.calcOpticalFlowPyrLK(first, other, corners, None)
        rests = (np.linalg.norm(ends - corners, axis=-1)[:, 0] < still) & (is_tracked[:, 0] > 0)
        if np.mean(rests) < _STILL_SHARE:
            return False
    return True


def _corners(image: ImageArray) -> Iterator[Array]:
    """Corners (N, 1, 2) of those cells of an image that have some."""
    cv2 = load_opencv()
    rows, columns = (np.linspace(0, side, _CELLS + 1).astype(int) for side in image.shape)
    for top, bottom in pairwise(rows):
        for left, right in pairwise(columns):
            cell = np.ascontiguousarray(image[top:bottom, left:right])
            corners = cv2.goodFeaturesToTrack(cell, _CORNERS, 0.05, max(4, image.shape[1] / 60))
            if corners is not None:
                yield corners + np.array([left, top], np.float32)


def common_times(films: Sequence[Film], count: int) -> list[float]:
    """At most ``count`` capture times in seconds, evenly spread over what all films saw, off its ends.

    Raises:
        FrogError: if the films share no time.
    """
    start = max(film.time_of(0) for film in films)
    end = min(film.time_of(min(film.facts.frame_count, _BACKGROUND_FRAMES) - 1) for film in films)
    if end < start:
        raise FrogError("The films have no time in common: each starts when another has ended.")
    first = films[0]  # at the times of its frames: where films are in step nothing has to be carried
    even = [start + (end - start) * (index + 0.5) / count for index in range(count)]
    return sorted({min(max(first.time_of(round(first.frame_at(time))), start), end) for time in even})


def view_film(film: Film, times: Sequence[float], check: Callable[[], None]) -> View:
    """A standing camera's view: its background, and its images nearest to capture times in seconds.

    Args:
        check: called before each image; it raises what ends the work.
    """
    count = film.facts.frame_count
    background = spread(min(count, _BACKGROUND_FRAMES), _BACKGROUND_IMAGES)
    nearest = [round(film.frame_at(time)) for time in times]
    needed = sorted({frame for frame in (*background, *nearest) if 0 <= frame < count})
    images: dict[int, ImageArray] = {}
    for frame, image in zip(needed, film.gray(needed, LONGEST_SIDE), strict=True):
        check()
        images[frame] = image
    stack = np.stack([images[frame] for frame in background])
    moments = [moment for moment, frame in enumerate(nearest) if frame in images]
    shown = np.array([images[nearest[moment]] for moment in moments], np.uint8).reshape(-1, *stack.shape[1:])
    median = _over_time(stack, np.median).round().astype(np.uint8)
    return View(median, _changing(stack), shown, np.array(moments, np.int64))


def images_at(film: Film, times: Sequence[float], check: Callable[[], None]) -> Iterator[ImageArray | None]:
    """The images nearest to ascending capture times; None where the film has none."""
    frames = [round(film.frame_at(time)) for time in times]
    needed = sorted({frame for frame in frames if 0 <= frame < film.facts.frame_count})
    decoded = film.source.decode(needed)
    last, image = -1, None
    for frame in frames:
        check()
        if not 0 <= frame < film.facts.frame_count:
            yield None
            continue
        if frame != last:
            last, image = frame, next(decoded)
        yield image


def _over_time(stack: Array, figure: Callable[..., Any]) -> Array:  # Any: to numpy a figure is one number
    """(H, W) a figure of the images (N, H, W), in strips: numpy's copies are large."""
    return np.concatenate([figure(stack[:, top : top + 64], axis=0) for top in range(0, stack.shape[1], 64)])


def _changing(stack: Array) -> Bools:
    """(H, W) bool: where the brightness varies, widened by what a feature sees of its surroundings."""
    deviation = _over_time(stack, partial(np.std, dtype=np.float32))
    side = 2 * max(1, round(stack.shape[2] / 160)) + 1
    wide = load_opencv().dilate((deviation > _CHANGES).astype(np.uint8), np.ones((side, side), np.uint8))
    return np.asarray(wide > 0)
