"""What each camera filmed: a video, or the images of a folder. Layouts that take videos take folders of frames too.

``cam00.mp4``, ``cam00/0000.png``, ``cam00/images/0000.png`` and ``cam00/C0001.MP4`` (a card a folder) are all the
footage of ``cam00``. The number in an image's name is its time: what is missing stays a gap, and two cameras' images of
one number belong together.

Several films of each camera are several recordings: ``cam00/walk.avi`` and ``cam00/run.avi``, or ``walk-cam00.mp4`` and
``run-cam00.mp4``. A recording is named by a path where no file is, ``FOLDER/walk``: beside the cameras' folders, or
where the films lie.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import groupby
from pathlib import Path

import numpy as np

from ...arrays import ImageArray
from ...errors import FrogError, found_instead, listed
from ..natural_order import natural
from ..video import (
    IMAGE_SUFFIXES,
    VideoFacts,
    composed,
    decode,
    find_images,
    find_videos,
    image_facts,
    read_facts,
    read_image,
)
from .chapters import films_of
from .readings import CAMERAS, FOLDERS, MOVING, Reading, readings, split_number

MAX_CAMERAS = 10_000
DIGITS = re.compile(r"[0-9]+")
BETWEEN = "-_. "  # words of a name
RATE = 30.0
"""Images a second, where nothing says it."""
_NO_CAMERAS = frozenset({"masks", "mask", "ignore", "seg", "depth", "depths", "images_2", "images_4", "images_8"})
_CARDS = ("DCIM/*", "PRIVATE/M4ROOT/CLIP", "PRIVATE/AVCHD/BDMV/STREAM")  # where cameras put films


@dataclass(frozen=True)
class Footage:
    """What one camera filmed.

    Attributes:
        name: of the video or the folder.
        files: one video, or its chapters, or images in the order of their numbers.
        numbers: of the images; empty for a video.
        strays: images of the folder that are named unlike the others.
        recording: the path that names the recording which a video in a camera's folder belongs to.
    """

    name: str
    files: tuple[Path, ...]
    numbers: tuple[int, ...] = ()
    strays: tuple[Path, ...] = ()
    recording: Path | None = None

    @classmethod
    def of_image(cls, image: Path) -> Footage:
        """That of a camera that took a single image."""
        return cls(composed(image.stem), (image,), (0,))

    @property
    def is_video(self) -> bool:
        """True for a video, False for images."""
        return not self.numbers

    @property
    def path(self) -> Path:
        """The video, or the camera's folder of images."""
        folder = self.files[0].parent
        return self.files[0] if self.is_video else folder.parent if folder.name == "images" else folder

    @cached_property
    def facts(self) -> VideoFacts:
        """As a player would show it: a chapter begins a frame after the one before has ended, and the image of number
        k was taken at k / 30 seconds.

        Raises:
            FrogError: if the video, or the first image, cannot be decoded, or chapters have different sizes.
        """
        if not self.is_video:
            return image_facts(self.files[0], np.array(self.numbers, np.float64) / RATE, RATE)
        first, *others = self._chapters
        times = first.timestamps
        for file, facts in zip(self.files[1:], others, strict=True):
            if (facts.width, facts.height) != (first.width, first.height):
                found = f"{facts.width} x {facts.height} pixels in a chapter of {self.files[0].name}"
                raise found_instead(file, found, f"{first.width} x {first.height}: are these two films?")
            start = times[-1] + 1 / first.frames_per_second
            times = np.concatenate([times, start + facts.timestamps - facts.timestamps[0]])
        return replace(first, frame_count=len(times), timestamps=times)

    @property
    def begins(self) -> list[float]:
        """Second of a video at which each of its files begins."""
        if len(self.files) == 1:
            return [0.0]
        firsts = np.cumsum([0, *(facts.frame_count for facts in self._chapters[:-1])])
        return list(map(float, self.facts.timestamps[firsts] - [facts.timestamps[0] for facts in self._chapters]))

    @cached_property
    def _chapters(self) -> list[VideoFacts]:
        """Of each file of a video."""
        return list(map(read_facts, self.files))

    def place(self, frame: int) -> tuple[Path, int]:
        """The file that holds a frame of a video, and which of its frames that is."""
        for file, facts in zip(self.files[:-1], self._chapters, strict=False):
            if frame < facts.frame_count:
                return file, frame
            frame -= facts.frame_count
        return self.files[-1], frame

    @property
    def state(self) -> list[object]:
        """What tells it from other footage or from what it was, without reading it."""
        states = [file.stat() for file in self.files]
        return [self.name, sum(state.st_size for state in states), *sorted({state.st_mtime_ns for state in states})]

    def decode(self, indices: Sequence[int]) -> Iterator[ImageArray]:
        """The frames with these ascending indices, each (H, W, 3) uint8 RGB.

        Raises:
            FrogError: if one cannot be decoded, or an image has another size than the first.
        """
        if self.is_video:
            for file, frames in groupby(map(self.place, indices), key=lambda frame: frame[0]):
                yield from decode(file, [index for _, index in frames])
            return
        width, height = self.facts.width, self.facts.height
        for file in (self.files[index] for index in indices):
            image = read_image(file)
            if image.shape[:2] != (height, width):
                found = f"an image of {image.shape[1]} x {image.shape[0]} pixels"
                raise found_instead(file, found, f"{width} x {height}, the size of {self.files[0].name}")
            yield image


def find_footage(folder: Path) -> list[Footage]:
    """Videos of a folder and folders of images in it, in the natural order of their names; of both by one name the
    video. Where the folder itself holds no video, those in its folders are the footage of these: several of each
    camera, unless ``folder`` names a recording.

    Raises:
        FrogError: for two videos of one name, and for more than ``MAX_CAMERAS``.
    """
    if not folder.is_dir():
        there = find_footage(folder.parent) if folder.parent.is_dir() else []
        return [of_camera for of_camera in there if of_camera.recording == folder]
    films = _films_of(folder)
    names = [film.name for film in films]
    if len(set(names)) < len(names):
        raise found_instead(folder, f"several videos named {max(names, key=names.count)}", "one video for each camera")
    in_folders: list[Footage] = []
    for entry in folder.iterdir():
        if entry.is_dir() and not entry.name.startswith(".") and entry.name.lower() not in _NO_CAMERAS:
            in_folders += _of_folder(entry, with_films=not films)
        if len(in_folders) > MAX_CAMERAS:
            raise found_instead(folder, f"more than {MAX_CAMERAS:,} folders of images", "one for each camera")
    films += [of_camera for of_camera in in_folders if of_camera.name not in names]
    return sorted(films, key=lambda footage: natural(footage.name))


def _of_folder(folder: Path, *, with_films: bool) -> list[Footage]:
    """A camera's images or its films, which may lie on a card that was copied there: a few images beside a film are
    stills, many are its frames."""
    places = [folder, *(inside for card in _CARDS for inside in sorted(folder.glob(card)))]
    images = next((replace(found, name=composed(folder.name)) for place in places if (found := images_in(place))), None)
    films = next(filter(None, map(_films_of, places)), []) if with_films else []
    if images and (not films or 2 * len(images.files) > min(film.facts.frame_count for film in films)):
        return [images]
    return [replace(film, name=composed(folder.name), recording=folder.parent / film.files[0].stem) for film in films]


def images_in(folder: Path) -> Footage | None:
    """The images of a camera's folder, or of ``images`` in it; None where there are none."""
    images = find_images(folder) or find_images(folder / "images")
    return _in_order(composed(folder.name), images) if images else None


Way = tuple[Reading, list[Footage]]
"""A way to read the names of images, and what its cameras filmed."""


def regrouped(footage: Sequence[Footage]) -> list[Way]:
    """What filmed what: folders are cameras, or, as far as the names of images allow it, moments, or nothing."""
    files = [(of_folder, file) for of_folder in footage for file in (*of_folder.files, *of_folder.strays)]
    cameras = tuple(of_folder.name for of_folder in footage for _ in of_folder.files)
    times = tuple(number for of_folder in footage for number in of_folder.numbers or (0,))
    ways: list[Way] = [(Reading(CAMERAS, FOLDERS, cameras, times), [*footage])]
    if not footage or any(of_folder.is_video for of_folder in footage):
        return ways
    kinds = [DIGITS.sub("0", of_folder.name) for of_folder, _ in files]
    folders = Counter(DIGITS.sub("0", of_folder.name) for of_folder in footage)
    kind = max(kinds, key=lambda kind: (folders[kind], kinds.count(kind)))
    others = tuple(file for (_, file), own in zip(files, kinds, strict=True) if own != kind)
    files = [pair for pair, own in zip(files, kinds, strict=True) if own == kind]
    if folders[kind] == 1 and {file.name for _, file in files} & {file.name for file in others}:
        return ways  # moments or recordings that words name
    for reading in readings([f"{of_folder.name}/{file.name}" for of_folder, file in files]):
        if reading.choice != MOVING and reading.layout != FOLDERS:
            first, *further = as_read(reading, [file for _, file in files])
            ways.append((reading, [replace(first, strays=others), *further]))
    return ways


def as_read(reading: Reading, files: Sequence[Path]) -> list[Footage]:
    """What the cameras filmed as a reading of the images' names tells it, in the natural order of their names."""
    by_camera: dict[str, dict[int, Path]] = {}
    for file, camera, time in zip(files, reading.cameras, reading.times, strict=True):
        by_camera.setdefault(composed(camera), {})[time] = file
    films = [(name, dict(sorted(of.items()))) for name, of in sorted(by_camera.items(), key=lambda of: natural(of[0]))]
    return [Footage(name, (*of.values(),), (*of,)) for name, of in films if name.lower() not in _NO_CAMERAS]


def _in_order(name: str, images: list[Path]) -> Footage:
    """A folder's images, in natural order, by their numbers, without those that are named unlike most."""
    parts = {image: split_number(image.stem) for image in images}
    kinds = Counter((prefix, image.suffix.lower()) for image, (prefix, number) in parts.items() if number is not None)
    kind, count = next(iter(kinds.most_common(1)), (None, 0))
    if 2 * count < len(images):  # their numbers are not those of frames
        return Footage(name, tuple(images), tuple(range(len(images))))
    alike = [
        (n, image) for image, (prefix, n) in parts.items() if n is not None and (prefix, image.suffix.lower()) == kind
    ]
    numbered = dict(sorted(dict(reversed(alike)).items()))  # the first of those with one number
    taken = {*numbered.values()}
    return Footage(name, (*numbered.values(),), (*numbered,), tuple(image for image in images if image not in taken))


def is_recording(path: Path) -> bool:
    """Whether a path where no file is may name a recording; False, not an error, without permission."""
    try:
        there = find_footage(path.parent) if path.parent.is_dir() and not path.exists() else []
    except (OSError, FrogError):
        return False
    return any(is_of(path, of_camera) for of_camera in there)


def is_of(recording: Path, film: Footage) -> bool:
    """Whether the path of a recording may be that of a film's: is what its name leaves beside the camera's."""
    name, whole = recording.name, film.name.strip(BETWEEN)
    rests = ((name[:cut], name[cut:]) for cut in range(len(name) + 1))
    return film.recording == recording or any(whole.startswith(one) and whole.endswith(other) for one, other in rests)


def several_recordings(where: Path, recordings: Sequence[Path], holder: Path | None = None) -> FrogError:
    """The error for footage of which one recording is to be chosen; a ``holder`` of films may be one itself."""
    shown = listed([recording.name for recording in recordings])
    itself = f", or a folder whose films are of a camera each: {holder}" if holder else ""
    expected = f"the path of one of them, as {recordings[0]}{itself}"
    return found_instead(where, f"{len(recordings)} recordings ({shown})", expected)


def footage_at(path: Path) -> Footage:
    """That of a single path; see ``footage_of``."""
    return next(footage_of([path]))


def footage_of(paths: Iterable[Path]) -> Iterator[Footage]:
    """Of each path the video with its chapters, the image, or the images of the folder in the order of their numbers.

    Raises:
        FrogError: for a folder without images.
    """
    films: dict[Path, dict[Path, Footage]] = {}  # by folder: which file goes on in which is asked once
    for path in paths:
        if path.is_dir():
            if (footage := images_in(path)) is None:
                raise found_instead(path, "a folder without images", "one image for each frame, such as 000001.png")
            yield footage
        elif path.suffix.lower() in IMAGE_SUFFIXES:
            yield Footage.of_image(path)
        else:
            if path.parent not in films:
                films[path.parent] = {film.files[0]: film for film in _films_of(path.parent)}
            yield films[path.parent].get(path) or _film((path,))


def _films_of(folder: Path) -> list[Footage]:
    """The films, with their chapters, of the videos that lie in a folder."""
    return list(map(_film, films_of(find_videos(folder))))


def _film(files: tuple[Path, ...]) -> Footage:
    return Footage(composed(files[0].stem), files)
