"""Which of a capture's frames is shown when: a retiming, frame by frame, whatever made it."""

from __future__ import annotations

import math
from dataclasses import dataclass

MOST_FRAMES = 1_048_574
"""Frames of a retiming: as many as a timeline of Blender has."""
FASTEST_RATE = 1000.0
"""Frames a second."""


@dataclass(frozen=True)
class Timing:
    """A retiming.

    Attributes:
        frames: of the capture, counted from 0, one for each frame that is shown; fractions are legal. None, before the
            first and after the last one that there is, where nothing is shown.
        rate: frames a second.
        start: frame number of the first one on a timeline.

    Raises:
        ValueError: for frames or a rate that cannot be.
    """

    frames: tuple[float | None, ...]
    rate: float
    start: int = 1

    def __post_init__(self) -> None:
        if not 1 <= len(self.frames) <= MOST_FRAMES:
            raise ValueError(f"a timing of {len(self.frames):,} frames")
        if not 0 < self.rate <= FASTEST_RATE:
            raise ValueError(f"a timing at {self.rate:g} frames a second")
        if not all(math.isfinite(frame) for frame in self.frames if frame is not None):
            raise ValueError("a timing with a frame that is not finite")
        shown = [frame is not None for frame in self.frames]
        if sum(before != after for before, after in zip([False, *shown], [*shown, False], strict=True)) > 2:
            raise ValueError("a timing that shows nothing between two of its frames")

    def capture_frame(self, frame: int) -> float:
        """The capture's frame at one of these, counted from 0; 0 where nothing is shown."""
        return self.frames[frame] or 0.0
