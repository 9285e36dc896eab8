"""Images of cameras that move, in order: which frames of a film are used, and those frames as files."""

from __future__ import annotations

import re
import shutil
from collections.abc import Sequence
from dataclasses import dataclass
from math import ceil
from pathlib import Path

import numpy as np

from ...errors import FrogError, found_instead
from ...io.atomic_files import write_atomically
from ...io.work_folder import key_of
from ..synchronization.films import Film, kinds_of, spread
from ..synchronization.run import Run
from ..video import decode, find_images, find_videos, image_size, load_opencv

_LEAST_IMAGES = 8  # of a camera, below which it is not taken for a moving one
_MOST_IMAGES = 300
_FOLDERS = (".", "images", "input", "frames")
_NAME = re.compile(r"scan(_.*)?", re.IGNORECASE)  # of a walk-through
_WALK_RATE = 3.0  # images a second of a walk-through
_FEWEST_OF_WALK, _MOST_OF_WALK = 24, 90


@dataclass(frozen=True)
class ImageSequence:
    """The images of one moving camera, in order.

    Attributes:
        images: the files.
        size: width and height in pixels of each.
        group: cameras of one group share their lens.
    """

    images: tuple[Path, ...]
    size: tuple[int, int]
    group: int = 0


def still_images(folder: Path) -> list[Path]:
    """The images of a moving camera in order of their names, where a folder holds such and no video; else none."""
    if find_videos(folder):
        return []
    for name in _FOLDERS:
        if (folder / name).is_dir():
            images = find_images(folder / name)
            if len(images) >= _LEAST_IMAGES:
                return images
    return []


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


def walk_images(run: Run, films: Sequence[Film]) -> list[ImageSequence]:
    """Some images of walk-throughs, evenly spread, in the work folder.

    Raises:
        Stopped: if the run was cancelled.
        FrogError: if a film cannot be decoded.
    """
    sequences = []
    for film, group in zip(films, kinds_of(films), strict=True):
        count = film.facts.frame_count
        images = int(np.clip(_WALK_RATE * film.duration, _FEWEST_OF_WALK, _MOST_OF_WALK))
        frames = spread(count, images)
        paths = _written(run, film, frames, run.work.path / f"walk-through-{key_of(film.state)}")
        sequences.append(ImageSequence(tuple(paths), film.size, group))
    return sequences


def film_images(run: Run, film: Film, out: Path) -> tuple[ImageSequence, list[float], list[str]]:
    """The images of a moving camera's film below ``out``, when each was taken in seconds, and warnings.

    Raises:
        Stopped: if the run was cancelled.
        FrogError: for a film of too few frames, or one that cannot be decoded.
    """
    count = film.facts.frame_count
    if count < _LEAST_IMAGES:
        raise found_instead(film.path, f"{count} frames", f"at least {_LEAST_IMAGES} of a moving camera")
    step = max(1, ceil(count / _MOST_IMAGES))
    frames = list(range(0, count, step))
    warnings = [f"{film.path.name}: every {step}. frame is used."] if step > 1 else []
    paths = _written(run, film, frames, out / f"{film.name}_images")
    times = [round(float(time - film.stamps[0]), 6) for time in film.stamps[frames]]  # to what readers tell apart
    return ImageSequence(tuple(paths), film.size), times, warnings


def image_files(images: Sequence[Path], out: Path) -> tuple[ImageSequence, list[float], list[str]]:
    """One camera's images, copied into ``out`` where they lie elsewhere, their times from 0 to 1, and no warnings."""
    sizes = {image_size(path) for path in images}
    if len(sizes) > 1:
        raise FrogError(f"{images[0].parent}: found images of {len(sizes)} sizes, expected those of one camera.")
    listed = list(images)
    if not all(path.resolve().is_relative_to(out.resolve()) for path in images):
        listed = [out / "images" / path.name for path in images]
        listed[0].parent.mkdir(parents=True, exist_ok=True)
        for image, copy in zip(images, listed, strict=True):
            if not copy.is_file():
                shutil.copyfile(image, copy)
    times = (np.arange(len(listed)) / max(len(listed) - 1, 1)).tolist()
    return ImageSequence(tuple(listed), sizes.pop()), times, []


def _written(run: Run, film: Film, frames: Sequence[int], target: Path) -> list[Path]:
    """The frames as images without loss in a folder; those that are there already stay."""
    cv2 = load_opencv()
    paths = {frame: target / f"{frame:06d}.png" for frame in frames}
    missing = [frame for frame in frames if not paths[frame].is_file()]
    for index, (frame, image) in enumerate(zip(missing, decode(film.path, missing), strict=True)):
        run.progress("images", index, len(missing))
        run.check()
        _, content = cv2.imencode(".png", cv2.cvtColor(image, cv2.COLOR_RGB2BGR))
        write_atomically(paths[frame], content.tobytes())
    return [paths[frame] for frame in frames]
