"""One camera's film as synchronisation sees it: when its frames were taken by its own clock, and gray images."""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from hashlib import blake2b
from pathlib import Path

import numpy as np

from ...arrays import Float64s, ImageArray
from ...errors import found_instead
from ..readers.film_frames import decode_film, film_facts, state_of
from ..video import load_opencv

LONGEST_SIDE = 720
"""Pixels of the gray images: enough for features, and a phone's film costs no more than a small one."""

_VERSION = 1  # raise it when another result would come of the same film


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
        return min(1.0, LONGEST_SIDE / max(self.width, self.height))

    def gray(self, indices: Sequence[int]) -> Iterator[ImageArray]:
        """The frames with these ascending indices, each (H, W) uint8, scaled to at most LONGEST_SIDE.

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
