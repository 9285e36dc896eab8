"""Walk-throughs of the set beside standing cameras: which films they are, and their images."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np

from ...errors import FrogError
from ...io.child_process import Progress
from .camera_kinds import numbered
from .films import Film
from .moving_films import sharpest, written
from .walk import Walk
from .work_folder import WorkFolder, key_of, key_of_file

_NAME = re.compile(r"scan(_.*)?", re.IGNORECASE)


def walk_throughs(folder: Path, films: Sequence[Film], standing: Sequence[bool]) -> tuple[list[Film], list[str]]:
    """Those of the films that are walk-throughs beside standing cameras, and what to tell about them.

    They are named scan or scan_..., and move; or the one film that moves is one.

    Raises:
        FrogError: if several others move.
    """
    moving = [film for film, stands in zip(films, standing, strict=True) if not stands]
    if not moving or len(moving) == len(films):
        return [], []
    others = [film for film in moving if not _NAME.fullmatch(film.name)]
    if len(others) > 1 or (others and len(moving) > 1):
        names = ", ".join(film.name for film in others)
        raise FrogError(
            f"{folder}: found {names} moving beside standing cameras, expected one walk-through (scan.mp4, or several: "
            "scan_1.mp4, scan_2.mp4), or standing cameras alone."
        )
    told = [f"{film.path.name} moves while the others stand: it was used as a walk-through." for film in others]
    return moving, told


def walks_of(films: Sequence[Film], work: WorkFolder, progress: Progress, cancelled: Callable[[], bool]) -> list[Walk]:
    """The sharp images of walk-throughs, in the work folder, of an earlier run or new.

    Raises:
        Stopped: if ``cancelled`` said so.
        FrogError: if a film cannot be decoded.
    """
    groups = numbered([(film.size, film.kind) for film in films])
    walks = []
    for place, (film, group) in enumerate(zip(films, groups, strict=True)):
        progress("images", place, len(films))
        key = key_of(key_of_file(film.path))
        kept = work.load("sharp", key)
        if kept is None:
            kept = {"frames": np.array(sharpest(film, cancelled), np.int64)}
            work.keep("sharp", key, kept)
        paths = written(film, kept["frames"].tolist(), work.path / f"scan-{key}", progress, cancelled)
        walks.append(Walk(film.name, tuple(paths), film.size, group))
    return walks
