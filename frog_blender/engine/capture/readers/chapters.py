"""Films that cameras split into files, by chapters in their names (GoPro) or by times that go on (DJI and others)."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cache
from itertools import groupby
from pathlib import Path

import numpy as np

from ...arrays import ImageArray
from ...errors import FrogError, found_instead
from ..media import read_film_header
from ..video import VideoFacts, decode, read_facts
from .readings import split_number

_GOPRO = re.compile(r"(.*?G[XHLP])(\d\d)(\d{4})(\D.*)?", re.IGNORECASE)  # GX010040, GX020040; GP010001
_FIRST_OF_OLD = re.compile(r"(.*?G)OPR(\d{4})(\D.*)?", re.IGNORECASE)  # GOPR0001, before GP010001
_AT_ONCE = 2.0  # seconds between the end of a file and the start of the next one
_CREATED = "creation_time"


@dataclass(frozen=True, eq=False)
class Chapters:
    """The files of one film in their order, and the facts of each."""

    files: tuple[Path, ...]
    of_files: tuple[VideoFacts, ...]

    @classmethod
    def read(cls, files: Sequence[Path]) -> Chapters:
        """FrogError for a file that cannot be decoded, or of another size than the first."""
        of_files = tuple(map(read_facts, files))
        for file, facts in zip(files, of_files, strict=True):
            first = of_files[0].width, of_files[0].height
            if (facts.width, facts.height) != first:
                found = f"{facts.width} x {facts.height} pixels in a chapter of {files[0].name}"
                raise found_instead(file, found, f"{first[0]} x {first[1]}: are these two films?")
        return cls(tuple(files), of_files)

    @property
    def facts(self) -> VideoFacts:
        """Of the whole film; a chapter begins a frame after the one before has ended."""
        first, *others = self.of_files
        times = first.timestamps
        for facts in others:
            start = times[-1] + 1 / first.frames_per_second
            times = np.concatenate([times, start + facts.timestamps - facts.timestamps[0]])
        return replace(first, frame_count=len(times), timestamps=times)

    def place(self, frame: int) -> tuple[Path, int]:
        """The file that holds a frame of the film, and which of its frames that is."""
        for file, facts in zip(self.files[:-1], self.of_files, strict=False):
            if frame < facts.frame_count:
                return file, frame
            frame -= facts.frame_count
        return self.files[-1], frame

    def decode(self, indices: Sequence[int]) -> Iterator[ImageArray]:
        """See ``video.decode``."""
        for file, places in groupby(map(self.place, indices), key=lambda place: place[0]):
            yield from decode(file, [index for _, index in places])


def joined(videos: Sequence[Path]) -> list[tuple[Path, ...]]:
    """The files of each film among videos in natural order.

    Raises:
        FrogError: if a chapter between two others is missing.
    """
    films: dict[object, dict[int, Path]] = {}
    last: Path | None = None
    keys: dict[Path, object] = {}
    filmed = cache(_filmed)
    for video in videos:
        film, chapter = _chapter(video)
        if film is None:
            film = keys[last] if last is not None and _goes_on(last, video, filmed) else video
            chapter = len(films.get(film, ()))
        keys[video], last = film, video
        films.setdefault(film, {})[chapter] = video
    for chapters in films.values():
        if max(chapters) - min(chapters) >= len(chapters):
            names = ", ".join(video.name for _, video in sorted(chapters.items()))
            raise FrogError(
                f"{videos[0].parent}: found {names}, expected every chapter between the first and the last."
            )
    return [tuple(video for _, video in sorted(chapters.items())) for chapters in films.values()]


def _chapter(video: Path) -> tuple[object, int]:
    """What tells a GoPro's film from others, and the chapter's number; None for other names."""
    if match := _GOPRO.fullmatch(video.stem):
        return (match[1].upper(), match[3], match[4], video.suffix.lower()), int(match[2])
    if match := _FIRST_OF_OLD.fullmatch(video.stem):
        return (f"{match[1]}P".upper(), match[2], match[3], video.suffix.lower()), 0
    return None, 0


def _goes_on(one: Path, other: Path, filmed: Callable[[Path], tuple[np.datetime64, float] | None]) -> bool:
    """Whether the camera began the other file, of the next number, when the first one ended."""
    (before, number), (also_before, following) = split_number(one.stem), split_number(other.stem)
    if before != also_before or number is None or following != number + 1:
        return False
    first, second = filmed(one), filmed(other)
    if first is None or second is None:
        return False
    gap = float((second[0] - first[0]) / np.timedelta64(1, "s")) - first[1]
    return first[1] > 0 and abs(gap) <= _AT_ONCE


def _filmed(video: Path) -> tuple[np.datetime64, float] | None:
    """When a file was begun, and its seconds; None where it does not say."""
    try:
        header = read_film_header(video)
        return np.datetime64(header.tags[_CREATED].rstrip("Z"), "ms"), header.duration
    except (FrogError, KeyError, ValueError):
        return None
