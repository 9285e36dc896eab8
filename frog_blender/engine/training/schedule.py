"""Where in the training one is, and which picture comes next."""

from __future__ import annotations

from dataclasses import dataclass

import torch

from ..capture.capture import Capture


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
    """Draws training pictures, each as often as every other; never one that is withheld."""

    def __init__(self, capture: Capture) -> None:
        self._shots = [i for i, shot in enumerate(capture.shots) if not capture.is_test(shot)]
        self._by_frame: dict[int, list[int]] = {}
        for i in self._shots:
            self._by_frame.setdefault(capture.shots[i].frame, []).append(i)
        self._capture = capture

    def pick(self, generator: torch.Generator) -> int:
        """A shot index."""
        return self._shots[int(torch.randint(len(self._shots), (1,), generator=generator))]

    def pick_same_moment(self, shot: int, generator: torch.Generator) -> int:
        """Another camera at the moment of ``shot`` (the same picture when there is only one)."""
        there = self._by_frame[self._capture.shots[shot].frame]
        return there[int(torch.randint(len(there), (1,), generator=generator))]
