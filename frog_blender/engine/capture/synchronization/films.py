"""The films of a shoot, a camera each, with their times, and what all stages that look at them share.

That is what earlier runs kept, progress, an end, and processes of their own.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from shutil import rmtree
from typing import TypeVar

import numpy as np

from ...arrays import Float64s, ImageArray
from ...errors import CaptureRefused, FrogError, found_instead, listed
from ...io.child_process import Progress, Stopped, run_in_child
from ...io.plain_values import plain
from ...io.work_folder import WorkFolder, key_of
from ...notices import say
from ..readers.footage import Footage, find_footage, footage_at, regrouped, several_recordings
from ..readers.readings import CHOSEN, MOMENTS, chosen, is_moment
from ..video import READABLE, VideoFacts, load_opencv, shrunk, unread_format

NAME = ".frog_calibration"
"""The hidden folder of a calibration's stages, beside its result."""

_Item = TypeVar("_Item")
_Result = TypeVar("_Result")

Clocks = Mapping[str, tuple[float, float]]
"""Offset in seconds and rate of each camera's film: capture time = offset + rate * film time."""


@dataclass(frozen=True, eq=False)
class Film:
    """A video of one camera, or a folder of its frames.

    Attributes:
        name: of the camera: the video's, without its ending, or the folder's.
        path: of the video, the image or the folder.
        facts: of the video.
        offset, rate: capture time = offset + rate * film time, seconds.
        footage: what it consists of, where that is more than what lies at ``path``.
    """

    name: str
    path: Path
    facts: VideoFacts
    offset: float = 0.0
    rate: float = 1.0
    footage: Footage | None = None

    @classmethod
    def of(cls, footage: Footage) -> Film:
        """FrogError for footage that cannot be decoded."""
        return cls(footage.name, footage.path, footage.facts, footage=footage)

    @cached_property
    def source(self) -> Footage:
        """What it consists of."""
        return self.footage or footage_at(self.path)

    @property
    def size(self) -> tuple[int, int]:
        """Width and height in pixels."""
        return self.facts.width, self.facts.height

    @property
    def stamps(self) -> Float64s:
        """(N,) film times in seconds at which the frames are shown."""
        return self.facts.timestamps

    @property
    def interval(self) -> float:
        """Seconds between two frames (the median; a gap does not count)."""
        return float(np.median(np.diff(self.stamps)))

    @property
    def duration(self) -> float:
        """Seconds from the first frame to the last."""
        return float(self.stamps[-1] - self.stamps[0])

    @property
    def state(self) -> list[object]:
        """What tells the file, or the folder, from another one or an older one, for ``key_of``."""
        return self.source.state

    def frame_at(self, time: float) -> float:
        """The frame, a real number, that was taken at a capture time in seconds; beyond the ends at the mean rate."""
        stamps, film_time = self.stamps, (time - self.offset) / self.rate
        if film_time < stamps[0] or film_time > stamps[-1]:
            end = 0 if film_time < stamps[0] else len(stamps) - 1
            return end + float(film_time - stamps[end]) * self.facts.frames_per_second
        return float(np.interp(film_time, stamps, np.arange(len(stamps))))

    def time_of(self, frame: int) -> float:
        """The capture time in seconds at which a frame was taken."""
        return self.offset + self.rate * float(self.stamps[min(max(frame, 0), len(self.stamps) - 1)])

    def gray(self, frames: Sequence[int], longest: int) -> Iterator[ImageArray]:
        """The brightness (H, W) of frames, ascending, at most ``longest`` pixels a side; FrogError if undecodable."""
        cv2 = load_opencv()
        for image in self.source.decode(frames):
            yield shrunk(cv2.cvtColor(image, cv2.COLOR_RGB2GRAY), longest)


def spread(count: int, most: int) -> list[int]:
    """At most so many of ``count`` indices, evenly spread."""
    return sorted({round(index) for index in np.linspace(0, count - 1, min(count, most)).tolist()}) if count else []


def find_films(folder: Path) -> list[Film]:
    """The films of a folder, a camera each, in order of their names: its videos, those of its folders, or else its
    folders of frames, one of each camera or of each moment.

    Raises:
        FrogError: if there are none, two have one name, there are several recordings, names of frames can be read in
            two ways (see ``CHOSEN``), or one cannot be decoded.
    """
    footage = find_footage(folder)
    if not footage and not folder.is_dir():
        raise FrogError(f"{folder}: found no folder, expected one with a video of each camera.")
    if not footage and (unread := unread_format([*folder.glob("*"), *folder.glob("*/*")])):
        raise found_instead(folder, f"images in {unread}", READABLE)
    if not footage:
        below = next((below for below in sorted(folder.iterdir()) if below.is_dir() and find_footage(below)), None)
        expected = "one video of each camera, such as cam01.mp4, cam02.mp4, or a folder of frames of each"
        raise found_instead(
            folder, "no video", f"the folder that holds the cameras' own: {below}" if below else expected
        )
    if stills := [of_folder.name for of_folder in footage if not of_folder.is_video]:
        videos = [of_camera for of_camera in footage if of_camera.is_video]
        say(f"{folder}: folders of images beside videos are left out: {listed(stills)}." if videos else "")
        footage = videos or footage
    if len({of_camera.name for of_camera in footage}) < len(footage):
        recordings = sorted({of_camera.recording for of_camera in footage if of_camera.recording})
        raise several_recordings(folder, recordings, footage[0].path.parent)
    may_be_moments = CHOSEN.get() == MOMENTS or all(is_moment(of_folder.name) for of_folder in footage)
    ways = [(reading, films) for reading, films in regrouped(footage) if reading.is_grid]
    ways = [way for way in ways if may_be_moments or way[0].choice != MOMENTS or way[0].words > 0]
    best = chosen(folder, [reading for reading, _ in ways])
    return next(list(map(Film.of, films)) for reading, films in ways if reading.layout == best.layout)


def with_clocks(films: Sequence[Film], clocks: Clocks) -> list[Film]:
    """The films with the clocks that are known."""
    timed = ((film, clocks.get(film.name, (film.offset, film.rate))) for film in films)
    return [replace(film, offset=offset, rate=rate) for film, (offset, rate) in timed]


def kinds_of(films: Sequence[Film]) -> list[int]:
    """A number for each film: equal for those of one size."""
    sizes = sorted({film.size for film in films})
    return [sizes.index(film.size) for film in films]


# --- what all stages share


class CalibrationRefused(CaptureRefused):
    """The footage does not fix its cameras; the sentence says why, and what to film next time."""


@dataclass(frozen=True)
class Run:
    """A calibration as its stages see it.

    Attributes:
        work: keeps the stages, so that a second run with the same footage continues.
        progress: told a stage's name, and how much of how much is done.
        cancelled: asked several times a second; what it ends raises Stopped.
    """

    work: WorkFolder
    progress: Progress
    cancelled: Callable[[], bool]

    def check(self) -> None:
        """Called before each image: ends the work when it was cancelled."""
        if self.cancelled():
            raise Stopped

    def in_threads(
        self, stage: str, function: Callable[[_Item], _Result], items: Iterable[_Item], most: int = 64
    ) -> list[_Result]:
        """The results in order; PyAV and OpenCV work outside Python's lock, and numpy in part."""
        listed, results = list(items), []
        self.progress(stage, 0, len(listed))
        with ThreadPoolExecutor(min(most, os.cpu_count() or 1)) as threads:
            for result in threads.map(function, listed):
                self.check()
                results.append(result)
                self.progress(stage, len(results), len(listed))
        return results

    def in_child(self, function: Callable[..., _Result], *arguments: object) -> _Result:
        """What a function of calibration returns, run by a process of its own: a crash in a library ends that alone.

        Its arguments and its result pass as ``plain`` values. A last parameter ``tell`` is told its progress.
        """
        folder = self.work.path / f"{function.__name__}-{key_of(plain(arguments))}"
        result = run_in_child(
            function,
            *arguments,
            folder=folder,
            progress=self.progress,
            stopped=self.cancelled,
            failure=lambda end: f"The calibration's process {end}; nothing was written, and what is done is kept.",
            kind=CalibrationRefused,
        )
        rmtree(folder, ignore_errors=True)
        return result
