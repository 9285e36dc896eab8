"""Images of cameras that move, in order: which frames of a film are used, and those frames as files."""

import shutil
from collections.abc import Sequence
from dataclasses import dataclass, replace
from math import ceil
from os.path import commonpath
from pathlib import Path

import numpy as np

from ...errors import FrogError, found_instead
from ...io.work_folder import key_of
from ..media import Photograph, read_photograph
from ..readers import readings
from ..readers.footage import Footage, as_read, find_footage
from ..readers.readings import AUTO, MOVING, ONE_MOMENT, Reading, View
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
        reading: what they are of.
        footage: of the cameras, unless one camera moved.
        times: of each image in seconds, where the names do not tell and the photographs do.
    """

    images: tuple[Path, ...]
    reading: Reading
    footage: tuple[Footage, ...] = ()
    times: tuple[float, ...] | None = None

    def films(self) -> list[Film]:
        """Those of its cameras; FrogError for an image that cannot be decoded."""
        films = map(Film.of, self.footage)
        return [film if self.reading.is_grid else replace(film, path=film.source.files[0]) for film in films]


def still_images(folder: Path) -> list[Path]:
    """The images of a folder that holds no video, all in one folder or each in one of its own; else none."""
    if find_videos(folder):
        return []
    for name in _FOLDERS:
        images = find_images(folder / name)
        if len(images) >= _LEAST_IMAGES or (len(images) > 1 and not find_footage(folder / name)):
            return images
    footage = find_footage(folder)
    each = [of_folder.files[0] for of_folder in footage if not of_folder.is_video and len(of_folder.files) == 1]
    return each if 1 < len(each) == len(footage) else []


def find_stills(folder: Path, layout: str = AUTO) -> Stills | None:
    """What ``still_images`` are of, by their names and by what the photographs say; None where there are none.

    Args:
        layout: what somebody knows, of ``readings.LAYOUTS``, or ``STANDING``: no camera moved.

    Raises:
        FrogError: if several readings are left, or the one that somebody knows is none.
    """
    images = still_images(folder)
    if not images:
        return None
    names = [image.relative_to(folder).as_posix() for image in images]
    with readings.chosen_layout(AUTO if layout == STANDING else layout):
        candidates = readings.check_choice(folder, readings.readings(names, every=layout != AUTO))
    candidates = [reading for reading in candidates if layout != STANDING or reading.choice != MOVING]
    photographs = [read_photograph(image) for image in images]
    is_said = layout not in (AUTO, STANDING) or len(candidates) == 1
    left = readings.likely(candidates) if is_said else _meant(candidates, photographs)
    if len(left) != 1:
        raise readings.several_readings(folder, candidates if left else readings.readings(names, every=True))
    if left[0].choice != MOVING:
        return Stills(tuple(images), left[0], tuple(as_read(left[0], images)))
    times = [photograph.time for photograph in photographs if photograph is not None and photograph.time is not None]
    starts = {readings.split_number(name)[0] for name in names}
    if len(starts) == 1 or len({*times}) < len(images):  # the names tell, or nothing does
        return Stills(tuple(images), left[0])
    order = sorted(zip(times, images, strict=True))
    return Stills(tuple(image for _, image in order), left[0], times=tuple(time - order[0][0] for time, _ in order))


def _meant(candidates: Sequence[Reading], photographs: Sequence[Photograph | None]) -> list[Reading]:
    """The readings that names and photographs leave: by when these were taken, or else by which cameras."""
    known = [photograph for photograph in photographs if photograph is not None]
    kinds = [(photograph.camera, *sorted(photograph.size)) for photograph in known]
    kinds = kinds if len(known) == len(photographs) else []
    left = readings.likely(candidates, [View(kind=kind) for kind in kinds])
    if all(reading.is_grid for reading in left):  # an array's rows and columns are named as cameras and times are
        left += [of for of in candidates if of.choice == ONE_MOMENT and of.words >= left[0].words]
    times = [photograph.time for photograph in known if photograph.time is not None]
    if len(times) < len(photographs):
        return [reading for reading in left if reading.choice != MOVING or len({*kinds}) < 2]
    span, is_in_order = max(times) - min(times), times == sorted(times)
    if span > 0 and is_in_order == (span <= _AT_ONCE):
        return left  # a burst, or clocks that differ
    return [reading for reading in left if (reading.choice == ONE_MOMENT) == (span <= _AT_ONCE)]


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
        holder = Path(commonpath(images))  # where each lies in a folder of its own, their names may be the same
        listed = [out / "images" / "_".join(path.relative_to(holder).parts) for path in images]
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
