"""The films of a shoot, a camera each: videos or folders of frames, their times, and the make of their cameras."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from ...arrays import Float64s, ImageArray
from ...errors import found_instead
from ..media import film_tags, read_photograph
from ..readers.footage import decode_film, film_facts, find_footage, images_in, state_of
from ..video import VideoFacts, composed, find_videos, load_opencv
from .run import key_of

Clocks = Mapping[str, tuple[float, float]]
"""Offset in seconds and rate of each camera's film: capture time = offset + rate * film time."""
_KINDS = {
    "com.apple.quicktime.make": "make",
    "com.apple.quicktime.model": "model",
    "com.apple.quicktime.camera.focal_length.35mm_equivalent": "focal length",
    "com.android.manufacturer": "make",
    "com.android.model": "model",
    "make": "make",
    "model": "model",
    "firmware": "firmware",  # GoPro's begins with its model: HD9.01.01.60.00
}
_FIRMWARE_MODEL = re.compile(r"[A-Z]+\d+")


@dataclass(frozen=True, eq=False)
class Film:
    """A video of one camera, or a folder of its frames.

    Attributes:
        name: of the camera: the video's, without its ending, or the folder's.
        facts: of the video.
        offset, rate: capture time = offset + rate * film time, seconds.
        kind: make and model of its camera, "" where the file does not say.
    """

    name: str
    path: Path
    facts: VideoFacts
    offset: float = 0.0
    rate: float = 1.0
    kind: str = ""

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
        return state_of(self.path)

    @property
    def key(self) -> str:
        """A hash of ``state``."""
        return key_of(self.state)

    def frame_at(self, time: float) -> float:
        """The frame, a real number, that was taken at a capture time in seconds; beyond the ends at the mean rate."""
        stamps, wanted = self.stamps, (time - self.offset) / self.rate
        if wanted < stamps[0] or wanted > stamps[-1]:
            end = 0 if wanted < stamps[0] else len(stamps) - 1
            return end + float(wanted - stamps[end]) * self.facts.frames_per_second
        return float(np.interp(wanted, stamps, np.arange(len(stamps))))

    def time_of(self, frame: int) -> float:
        """The capture time in seconds at which a frame was taken."""
        return self.offset + self.rate * float(self.stamps[min(max(frame, 0), len(self.stamps) - 1)])

    def scale(self, longest: int) -> float:
        """Pixels of an image of at most ``longest`` a side for each pixel of the film, at most 1."""
        return min(1.0, longest / max(self.size))

    def gray(self, frames: Sequence[int], longest: int) -> Iterator[ImageArray]:
        """The brightness (H, W) of frames, ascending, at most ``longest`` pixels a side; FrogError if undecodable."""
        cv2 = load_opencv()
        for image in decode_film(self.path, frames):
            yield resized(cv2.cvtColor(image, cv2.COLOR_RGB2GRAY), longest)


def resized(gray: ImageArray, longest: int) -> ImageArray:
    """Brightness (H, W) at most ``longest`` pixels a side."""
    cv2 = load_opencv()
    scale = longest / max(gray.shape)
    if scale >= 1:
        return gray
    size = (max(1, round(gray.shape[1] * scale)), max(1, round(gray.shape[0] * scale)))
    return np.asarray(cv2.resize(gray, size, interpolation=cv2.INTER_AREA))


def find_films(folder: Path) -> list[Film]:
    """The films of a folder, a camera each, in order of their names: its videos, or else its folders of frames.

    Raises:
        FrogError: if there are neither, two have one name, or one cannot be decoded.
    """
    paths = find_videos(folder)
    names = [composed(video.stem) for video in paths]
    if not paths:
        paths = sorted((footage.files[0].parent for footage in find_footage(folder)), key=lambda path: path.name)
        paths = [path.parent if path.name == "images" else path for path in paths]
        names = [composed(path.name) for path in paths]
    if not paths:
        expected = "one video of each camera, such as cam01.mp4, cam02.mp4, or a folder of frames of each"
        raise found_instead(folder, "no video", expected)
    if len(set(names)) != len(names):
        twice = max(names, key=names.count)
        raise found_instead(folder, f"several videos named {twice}", "one video for each camera")
    return [Film(n, path, film_facts(path), kind=kind_of(path)) for n, path in zip(names, paths, strict=True)]


def with_clocks(films: Sequence[Film], clocks: Clocks) -> list[Film]:
    """The films with the clocks that are known."""
    return [
        replace(film, offset=clocks[film.name][0], rate=clocks[film.name][1]) if film.name in clocks else film
        for film in films
    ]


def kind_of(path: Path) -> str:
    """Make, model, and the lens where a phone has several, of a video or a folder of frames; "" where it is not said.

    Raises:
        FrogError: if the first frame cannot be read.
    """
    if not path.is_dir():
        return kind_by(film_tags(path))
    footage = images_in(path)
    photograph = None if footage is None else read_photograph(footage.files[0])
    return "" if photograph is None else ", ".join(photograph.camera)


def kind_by(tags: Mapping[str, str]) -> str:
    """The same by a film's tags."""
    found: dict[str, str] = {}
    for tag, value in tags.items():
        name = _KINDS.get(tag)
        if name is not None and value:
            found.setdefault(name, value)
    firmware = _FIRMWARE_MODEL.match(found.pop("firmware", ""))
    if firmware is not None:
        found.setdefault("model", firmware[0])
    return ", ".join(found[name] for name in ("make", "model", "focal length") if name in found)


def kinds_of(films: Sequence[Film], alike: float = 0.0) -> list[int]:
    """A number for each film: equal for those of one kind of camera, of one size, make and model.

    Args:
        alike: by what part of a side sizes may differ within a kind; encoders pad some films by a few pixels.
    """
    sizes: list[tuple[int, int]] = []

    def like(film: Film) -> int:
        fits = (all(abs(a - b) <= alike * max(a, b) for a, b in zip(film.size, size, strict=True)) for size in sizes)
        return next((index for index, is_alike in enumerate(fits) if is_alike), -1)

    for film in sorted(films, key=lambda film: film.size):
        if like(film) < 0:
            sizes.append(film.size)
    kinds = [(like(film), film.kind) for film in films]
    order = sorted(set(kinds))
    return [order.index(kind) for kind in kinds]
