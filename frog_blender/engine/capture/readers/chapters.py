"""Films that cameras split into files, by chapters in their names (GoPro) or by times that go on (DJI and others)."""

import re
from collections.abc import Callable, Sequence
from functools import cache
from pathlib import Path

import numpy as np

from ...errors import FrogError, found_instead
from ..media import read_film_header
from .readings import split_number

_GOPRO = re.compile(r"(.*?G)(?:([XHLP])(\d\d)|OPR)(\d{4})(\D.*)?", re.IGNORECASE)  # GX010040; GOPR0001, GP010001
_AT_ONCE = 2.0  # seconds between the end of a file and the start of the next one
_CREATED = "creation_time"


def films_of(videos: Sequence[Path]) -> list[tuple[Path, ...]]:
    """The files of each film among the videos of a folder, in the natural order of their names.

    Raises:
        FrogError: if a chapter between two others is missing.
    """
    films: dict[object, dict[int, Path]] = {}
    film: object
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
            raise found_instead(videos[0].parent, names, "every chapter between the first and the last")
    return [tuple(video for _, video in sorted(chapters.items())) for chapters in films.values()]


def _chapter(video: Path) -> tuple[tuple[str, ...] | None, int]:
    """What tells a GoPro's film from others, and the chapter's number; None for other names."""
    if match := _GOPRO.fullmatch(video.stem):
        before, kind, chapter, film, after = match.groups()
        return (f"{before}{kind or 'P'}".upper(), film, after, video.suffix.lower()), int(chapter or 0)
    return None, 0


def is_later_chapter(video: Path) -> bool:
    """Whether the name is that of a GoPro's chapter which others preceded."""
    film, chapter = _chapter(video)
    return film is not None and chapter > (0 if film[0].endswith("P") else 1)


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
