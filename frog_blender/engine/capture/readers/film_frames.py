"""A camera's film, whether it is a video or a folder of numbered images: its facts, and its frames."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np

from ...arrays import ImageArray
from ...errors import found_instead
from ..video import VideoFacts, decode, image_size, read_facts, read_image
from .footage import Footage, images_in

_RATE = 30.0  # images a second, of which a folder says nothing


def film_facts(path: Path) -> VideoFacts:
    """The facts of a video, or of a folder's images: image number k was taken at k / 30 seconds.

    Raises:
        FrogError: if the video cannot be decoded, or the folder holds no images in order.
    """
    if not path.is_dir():
        return read_facts(path)
    footage = _images(path)
    width, height = image_size(footage.files[0])
    times = np.array(footage.numbers, np.float64) / _RATE
    return VideoFacts(width, height, len(times), _RATE, times)


def decode_film(path: Path, indices: Sequence[int]) -> Iterator[ImageArray]:
    """The frames with these ascending indices, each (H, W, 3) uint8 RGB.

    Raises:
        FrogError: if one cannot be decoded, or an image has another size than the first.
    """
    if not path.is_dir():
        yield from decode(path, indices)
        return
    files = _images(path).files
    width, height = image_size(files[0])
    for index in indices:
        image = read_image(files[index])
        if image.shape[:2] != (height, width):
            found = f"an image of {image.shape[1]} x {image.shape[0]} pixels"
            raise found_instead(files[index], found, f"{width} x {height}, the size of {files[0].name}")
        yield image


def state_of(path: Path) -> list[object]:
    """What tells a film from another one or an older one, without reading it."""
    files = _images(path).files if path.is_dir() else (path,)
    states = [file.stat() for file in files]
    return [path.name, sum(state.st_size for state in states), *sorted({state.st_mtime_ns for state in states})]


def _images(folder: Path) -> Footage:
    """The images of a folder, in the order of their numbers."""
    footage = images_in(folder)
    if footage is None:
        raise found_instead(folder, "a folder without images", "one image for each frame, such as 000001.png")
    return footage
