"""What is due when, and which image comes next."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass

import torch

from ...capture.capture import Capture
from ..recipe import Recipe
from .peers import PeerLost

_ROUNDING = 1e-9  # of a computed fraction of the training: no training has as many steps


@dataclass(frozen=True)
class Limits:
    """When to stop: after so many steps, or so many seconds of training, whichever comes first."""

    steps: int | None = None
    seconds: float | None = None

    def progress(self, steps: int, seconds: float) -> float:
        """0 to 1 after so much of a training."""
        shares = [0.0]
        if self.steps:
            shares.append(steps / self.steps)
        if self.seconds:
            shares.append(seconds / self.seconds)
        return min(1.0, max(shares))


@dataclass(frozen=True)
class Every:
    """Rounds at the fractions start, start + interval, ... up to the end."""

    start: float
    until: float
    interval: float

    def due(self, before: float, now: float) -> bool:
        """True when a round lies in (before, now]."""
        rounds = self._begun(now)
        return now <= self.until + _ROUNDING and rounds >= 0 and rounds > self._begun(before)

    def _begun(self, progress: float) -> int:
        """Rounds that have begun, less one."""
        return math.floor((progress - self.start + _ROUNDING) / self.interval)


def ramp(progress: float, start: float, end: float) -> float:
    """0 before ``start``, 1 after ``end``, linear between."""
    if progress >= end:
        return 1.0
    return max(0.0, (progress - start) / (end - start)) if end > start else 0.0


def in_burst(recipe: Recipe, progress: float, step: int) -> bool:
    """Whether a step is in a burst of D-SSIM."""
    if not recipe.dssim_weight or progress < recipe.dssim_from:
        return False
    return step % recipe.dssim_period < recipe.dssim_burst


class ViewSampler:
    """Draws training images, each as often as every other; never one that is excluded for validation.

    Attributes:
        burst_shot: the image drawn last, whose frame a burst stays at; -1 before the first.
    """

    def __init__(self, capture: Capture) -> None:
        self._capture, self.burst_shot = capture, -1
        self._excluded: Sequence[int] = ()
        self._gather()

    def _gather(self) -> None:
        shots = self._capture.shots
        self._shots = [i for i in self._capture.train_indices if i not in self._excluded]
        self._by_frame: dict[int, list[int]] = {}
        for i in self._shots:
            self._by_frame.setdefault(shots[i].frame, []).append(i)

    def exclude(self, shots: Sequence[int]) -> None:
        """From now on draws none of these training shots, and all others."""
        if shots != self._excluded:
            self._excluded = shots
            self._gather()

    def next(self, recipe: Recipe, progress: float, step: int, generator: torch.Generator) -> int:
        """The shot to learn from. A burst of D-SSIM stays at one frame and changes the camera (E-D3DGS's multi-view
        SSIM)."""
        if in_burst(recipe, progress, step) and step % recipe.dssim_period and self.burst_shot >= 0:
            return self.pick_same_frame(self.burst_shot, generator)
        self.burst_shot = self.pick(generator)
        return self.burst_shot

    @contextmanager
    def unseen_where_lost(self, generator: torch.Generator) -> Iterator[None]:
        """Takes back what is drawn inside where a peer is lost: the step has not been done."""
        state, shot = generator.get_state(), self.burst_shot
        try:
            yield
        except PeerLost:
            generator.set_state(state)
            self.burst_shot = shot
            raise

    def pick(self, generator: torch.Generator) -> int:
        """A shot index."""
        return self._shots[int(torch.randint(len(self._shots), (1,), generator=generator))]

    def pick_same_frame(self, shot: int, generator: torch.Generator) -> int:
        """Another camera at the frame of ``shot`` (the same image when there is only one); any image when all of that
        frame are excluded."""
        there = self._by_frame.get(self._capture.shots[shot].frame, self._shots)
        return there[int(torch.randint(len(there), (1,), generator=generator))]
