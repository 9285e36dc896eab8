"""Where in the training one is, and which picture comes next."""

from __future__ import annotations

from dataclasses import dataclass

import torch

from ..capture.capture import Capture
from ..capture.time import frame_to_time


@dataclass(frozen=True)
class Every:
    """Rounds at fractions start, start + interval, ... up to the end."""

    start: float
    until: float
    interval: float

    def due(self, before: float, now: float) -> bool:
        """True when a round lies in (before, now]."""
        if now < self.start or now > self.until:
            return False
        return before < self.start or int((now - self.start) / self.interval) > int(
            (before - self.start) / self.interval
        )


def ramp(progress: float, start: float, end: float) -> float:
    """0 before ``start``, 1 after ``end``, linear between."""
    if progress >= end:
        return 1.0
    return max(0.0, (progress - start) / (end - start)) if end > start else 1.0


class ShotPicker:
    """Draws training pictures; at first from moments around the middle, in a window that widens to all.

    The first window is the smallest one with at least ``_FIRST_SHOTS`` pictures, so that one moving camera starts from
    several of its places too.
    """

    _FIRST_SHOTS = 8

    def __init__(self, capture: Capture) -> None:
        self._shots = [i for i, shot in enumerate(capture.shots) if not capture.is_test(shot)]
        times = [frame_to_time(capture.shots[i].frame, capture.frame_count) for i in self._shots]
        distances = torch.tensor([abs(time - 0.5) for time in times])
        self._order = distances.argsort(stable=True)
        self._distances = distances[self._order]
        self._first = float(self._distances[min(self._FIRST_SHOTS, len(times)) - 1])
        self._by_frame: dict[int, list[int]] = {}
        for i in self._shots:
            self._by_frame.setdefault(capture.shots[i].frame, []).append(i)
        self._capture = capture

    def pick(self, opened: float, generator: torch.Generator) -> int:
        """A shot index; ``opened`` is how far the window has widened, 0 to 1."""
        half = self._first + (0.5 - self._first) * opened
        usable = int((self._distances <= half + 1e-9).sum())
        drawn = int(torch.randint(max(1, usable), (1,), generator=generator))
        return self._shots[int(self._order[drawn])]

    def pick_same_moment(self, shot: int, generator: torch.Generator) -> int:
        """Another camera at the moment of ``shot`` (the same picture when there is only one)."""
        there = self._by_frame[self._capture.shots[shot].frame]
        return there[int(torch.randint(len(there), (1,), generator=generator))]
