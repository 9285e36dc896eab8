"""Images of cameras that move, in order: which frames of a film are used, and those frames as files."""

import shutil
from collections.abc import Sequence
from dataclasses import dataclass
from math import ceil
from pathlib import Path

import numpy as np

from ...errors import FrogError, found_instead
from ...io.work_folder import key_of
from ..media import Photograph, read_photograph
from ..readers.footage import Footage, find_footage
from ..readers.readings import AUTO, MOVING, ONE_MOMENT, likely, readings, split_number
from ..synchronization.films import Film, Run, kinds_of, spread
from ..video import find_images, find_videos, image_size, write_image
from .views import STANDING, WALK_THROUGH

_LEAST_IMAGES = 8  # of a camera, below which it is not taken for a moving one
_MOST_IMAGES = 300
_FOLDERS = (".", "images", "input", "frames")
_AT_ONCE = 2.0  # seconds by which the clocks of a rig's cameras may differ
_WALK_RATE = 3.0  # images a second of a walk-through
_FEWEST_OF_WALK, _MOST_OF_WALK = 24, 90


@dataclass(frozen=True)
class ImageSequence:
    """The images of one moving camera, in order.

    Attributes:
        images: the files.
        size: width and height in pixels of each.
        group: cameras of one group share their lens.
        times: of each in seconds; None where nothing has measured them.
    """

    images: tuple[Path, ...]
    size: tuple[int, int]
    group: int = 0
    times: tuple[float, ...] | None = None


@dataclass(frozen=True)
class Stills:
    """The images of a folder without videos.

    Attributes:
        images: in the order of their times.
        is_one_moment: each has a camera of its own, and all were taken at once; else one camera moved.
        times: of each in seconds, where the names do not tell and the photographs do.
    """

    images: tuple[Path, ...]
    is_one_moment: bool
    times: tuple[float, ...] | None = None

    def films(self) -> list[Film]:
        """Those of the standing cameras of one moment; FrogError for an image that cannot be decoded."""
        footage = list(map(Footage.of_image, self.images if self.is_one_moment else ()))
        return [Film(image.name, image.files[0], image.facts) for image in footage]


def still_images(folder: Path) -> list[Path]:
    """The images of a folder that holds no video, each of a camera of its own or all of a moving one; else none."""
    if find_videos(folder):
        return []
    for name in _FOLDERS:
        images = find_images(folder / name)
        if len(images) >= _LEAST_IMAGES or (len(images) > 1 and not find_footage(folder / name)):
            return images
    return []


def find_stills(folder: Path, layout: str = AUTO) -> Stills | None:
    """What ``still_images`` are of, by their names and by what the photographs say; None where there are none.

    Args:
        layout: ``AUTO``, or what somebody knows: ``MOVING``, ``ONE_MOMENT``, or ``STANDING``, which is the same.

    Raises:
        FrogError: if nothing tells which of the two they are.
    """
    images = still_images(folder)
    if not images:
        return None
    if layout in (ONE_MOMENT, STANDING):
        return Stills(tuple(images), is_one_moment=True)
    photographs = [read_photograph(image) for image in images]
    if layout != MOVING and _are_at_once(folder, images, photographs):
        return Stills(tuple(images), is_one_moment=True)
    times = [photograph.time for photograph in photographs if photograph is not None and photograph.time is not None]
    starts = {split_number(image.stem)[0] for image in images}
    if len(starts) == 1 or len({*times}) < len(images):  # the names tell, or nothing does
        return Stills(tuple(images), is_one_moment=False)
    order = sorted(zip(times, images, strict=True))
    return Stills(tuple(image for _, image in order), False, tuple(time - order[0][0] for time, _ in order))


def _are_at_once(folder: Path, images: Sequence[Path], photographs: Sequence[Photograph | None]) -> bool:
    words = {reading.choice for reading in likely(readings([image.name for image in images]))} & {MOVING, ONE_MOMENT}
    said = {ONE_MOMENT in words} if len(words) == 1 else set()
    measured = _measured_at_once(photographs)
    said |= set() if measured is None else {measured}
    if not words or len(said) != 1:
        raise FrogError(
            f"{folder}: found {len(images)} images ({images[0].name} to {images[-1].name}), and neither names nor "
            "files tell whose they are: say --moving for one camera that moved, --one-moment for a camera each at one "
            "time, or give each camera a folder of its images."
        )
    return said.pop()


def _measured_at_once(photographs: Sequence[Photograph | None]) -> bool | None:
    """Whether photographs were taken at once, by their times or else by their cameras; None where these do not tell."""
    known = [photograph for photograph in photographs if photograph is not None]
    times = [photograph.time for photograph in known if photograph.time is not None]
    if len(times) == len(photographs):
        span, is_in_order = max(times) - min(times), times == sorted(times)
        if span > _AT_ONCE:
            return False if is_in_order else None
        return None if span > 0 and is_in_order else True
    kinds = {(photograph.camera, *sorted(photograph.size)) for photograph in known}
    return True if len(kinds) > 1 and len(known) == len(photographs) else None


def walk_throughs(folder: Path, films: Sequence[Film], standing: Sequence[bool]) -> tuple[list[Film], list[str]]:
    """Those of the films that are walk-throughs beside standing cameras, and what to tell about them.

    They are named scan or scan_..., and move; or the one film that moves is one.

    Raises:
        FrogError: if several others move.
    """
    moving = [film for film, stands in zip(films, standing, strict=True) if not stands]
    if not moving or len(moving) == len(films):
        return [], []
    others = [film for film in moving if not WALK_THROUGH.fullmatch(film.name)]
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


def film_images(run: Run, film: Film, out: Path) -> tuple[ImageSequence, list[str]]:
    """The images of a moving camera's film below ``out``, and warnings.

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
    times = tuple(round(float(time - film.stamps[0]), 6) for time in film.stamps[frames])  # to what readers tell apart
    return ImageSequence(tuple(paths), film.size, times=times), warnings


def still_sequence(stills: Stills, out: Path) -> ImageSequence:
    """One moving camera's images, copied into ``out`` where they lie elsewhere.

    Raises:
        FrogError: if there are too few, or they have several sizes.
    """
    images = stills.images
    if len(images) < _LEAST_IMAGES:
        raise found_instead(images[0].parent, f"{len(images)} images", f"at least {_LEAST_IMAGES} of a moving camera")
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
    return ImageSequence(tuple(listed), sizes.pop(), times=stills.times)


def _written(run: Run, film: Film, frames: Sequence[int], target: Path) -> list[Path]:
    """The frames as images without loss in a folder; those that are there already stay."""
    paths = {frame: target / f"{frame:06d}.png" for frame in frames}
    missing = [frame for frame in frames if not paths[frame].is_file()]
    for index, (frame, image) in enumerate(zip(missing, film.source.decode(missing), strict=True)):
        run.progress("images", index, len(missing))
        run.check()
        write_image(paths[frame], image)
    return [paths[frame] for frame in frames]
