"""One camera's film as synchronisation sees it: when its frames were taken by its own clock, and what moves in it."""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from hashlib import blake2b
from pathlib import Path

import numpy as np

from ...arrays import Float64s, ImageArray
from ...errors import found_instead
from ..readers.footage import decode_film, film_facts, state_of
from ..video import load_opencv
from . import limits
from .work import Kept, Work

_VERSION = 1  # raise it when another result would come of the same film
_REPORTED = 50  # frames between reports


@dataclass(frozen=True, eq=False)
class Recording:
    """A video, or a folder of frames.

    Attributes:
        name: its camera.
        path: the file, or the folder.
        timestamps: (N,) float64 seconds, ascending: when each frame is shown.
        width, height: pixels, as stored.
    """

    name: str
    path: Path
    timestamps: Float64s
    width: int
    height: int

    @property
    def interval(self) -> float:
        """Seconds between two frames (the median; a gap does not count)."""
        return float(np.median(np.diff(self.timestamps)))

    @property
    def duration(self) -> float:
        """Seconds from the first frame to the last."""
        return float(self.timestamps[-1] - self.timestamps[0])

    @property
    def key(self) -> str:
        """Letters that tell the file from another one or an older one, without reading it."""
        said = f"{_VERSION} {os.path.abspath(self.path)} {state_of(self.path)}"
        return blake2b(said.encode(errors="surrogateescape"), digest_size=8).hexdigest()

    @property
    def scale(self) -> float:
        """Pixels of a gray image for each pixel of the film, at most 1."""
        return min(1.0, limits.LONGEST_SIDE / max(self.width, self.height))

    def gray(self, indices: Sequence[int]) -> Iterator[ImageArray]:
        """The frames with these ascending indices, each (H, W) uint8, scaled to at most limits.LONGEST_SIDE.

        Raises:
            FrogError: if the video cannot be decoded.
        """
        cv2 = load_opencv()
        size = (max(1, round(self.width * self.scale)), max(1, round(self.height * self.scale)))
        for image in decode_film(self.path, indices):
            gray = cv2.cvtColor(image, cv2.COLOR_RGB2GRAY)
            yield gray if gray.shape[::-1] == size else cv2.resize(gray, size, interpolation=cv2.INTER_AREA)


def open_recording(name: str, path: Path) -> Recording:
    """A camera's video; FrogError if it cannot be decoded or has fewer than three frames."""
    facts = film_facts(path)
    if facts.frame_count < 3:
        raise found_instead(path, f"a video of {facts.frame_count} frames", "at least three, in which something moves")
    return Recording(name, path, facts.timestamps, facts.width, facts.height)


Signal = tuple[Float64s, Float64s]
"""Film times in seconds, and values there."""


@dataclass(frozen=True, eq=False)
class Motion:
    """What moves in a film, by one pass over all of it.

    Attributes:
        energy: how much changes by second, between each two frames.
        region: (H, W) uint8 of the gray images, 255 where something moves, and nothing of the background.
    """

    energy: Signal
    region: ImageArray


def motion_of(film: Recording, work: Work, kept: Kept | None = None) -> Motion:
    """Decodes a film once, unless what came of it was kept; FrogError if it cannot be decoded."""
    if kept is not None and (arrays := kept.load("motion", film.key)) is not None:
        return Motion((arrays["times"], arrays["energies"]), arrays["region"])
    count = len(film.timestamps)
    sampled = {round(index) for index in np.linspace(0, count - 1, min(limits.BACKGROUND_SAMPLES, count))}
    small: ImageArray | None = None
    changes, samples = [], []
    for index, gray in enumerate(film.gray(range(count))):
        if index % _REPORTED == 0:
            work.step(f"Looking for motion in {film.name}", index, count)
        before, small = small, _reduced(gray)
        if before is not None:
            changes.append(float(np.maximum(np.abs(small - before) - limits.ENERGY_NOISE, 0).mean()))
        if index in sampled:
            samples.append(gray)
    motion = Motion(energy_signal(film.timestamps, changes), changing_region(samples))
    if kept is not None:
        arrays = {"times": motion.energy[0], "energies": motion.energy[1], "region": motion.region}
        kept.keep("motion", film.key, arrays)
    return motion


def energy_signal(timestamps: Float64s, changes: Sequence[float]) -> Signal:
    """Times (N - 1,) between each two of the frames, and the change (N - 1,) there by second."""
    times = timestamps[: len(changes) + 1]
    gaps = np.maximum(np.diff(times), 1e-6)
    return (times[1:] + times[:-1]) / 2, np.array(changes[: len(gaps)]) / gaps


def _reduced(gray: ImageArray) -> ImageArray:
    """A small image without details: of them, only noise would be left between two frames."""
    cv2 = load_opencv()
    height = max(2, round(gray.shape[0] * limits.ENERGY_WIDTH / gray.shape[1]))
    small = cv2.resize(gray, (limits.ENERGY_WIDTH, height), interpolation=cv2.INTER_AREA)
    blurred: ImageArray = cv2.GaussianBlur(small.astype(np.float32), (0, 0), limits.ENERGY_BLUR)
    return blurred


def changing_region(images: Sequence[ImageArray]) -> ImageArray:
    """(H, W) uint8 mask, 255 where gray images (each (H, W) uint8) of one view deviate from their median."""
    cv2 = load_opencv()
    stack = np.stack([cv2.GaussianBlur(image, (0, 0), 1.0) for image in images])
    median = np.median(stack, axis=0).astype(np.float32)
    # A high percentile, not the mean: a hand that passes once changes a pixel in few of the images.
    deviation = np.percentile(np.abs(stack.astype(np.float32) - median), 90, axis=0)
    mask = (deviation > limits.CHANGE).astype(np.uint8) * 255
    mask = cv2.morphologyEx(mask, cv2.MORPH_OPEN, np.ones((3, 3), np.uint8))
    radius = max(2, round(limits.REGION_MARGIN * mask.shape[1]))
    shape = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * radius + 1, 2 * radius + 1))
    grown: ImageArray = cv2.dilate(mask, shape)
    return grown
