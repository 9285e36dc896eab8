"""What is due when, which image comes next, which part of it is drawn, and how long a training has worked.

Most steps draw only a rectangle of an image, sampled where the errors are. The static part of an image is learned long
before the moving part, yet costs most of every step. A step on a crop costs little more than its share of the pixels.

Seconds for which the process was stopped, or the computer slept, are none of a training's.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch

from ...capture.camera import Camera
from ...capture.capture import Capture
from ...native.binding import CELL
from .stateful import Tensors, Values, expect

_ROUNDING = 1e-9  # of a computed fraction of the training: no training has as many steps


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


class ViewSampler:
    """Draws training images, each as often as every other; never one that is excluded for validation."""

    def __init__(self, capture: Capture) -> None:
        self._capture = capture
        self._excluded: Sequence[int] | None = None
        self.exclude(())

    def exclude(self, excluded: Sequence[int]) -> None:
        """From now on draws none of these training shots, and all others."""
        if excluded == self._excluded:
            return
        self._excluded = excluded
        self._shots = [i for i in self._capture.train_indices if i not in excluded]
        self._by_frame: dict[int, list[int]] = {}
        for i in self._shots:
            self._by_frame.setdefault(self._capture.shots[i].frame, []).append(i)

    def pick(self, generator: torch.Generator) -> int:
        """A shot index."""
        return self._shots[int(torch.randint(len(self._shots), (1,), generator=generator))]

    def pick_same_frame(self, shot: int, generator: torch.Generator) -> int:
        """Another camera at the frame of ``shot`` (the same image when there is only one); any image when all of that
        frame are excluded."""
        there = self._by_frame.get(self._capture.shots[shot].frame, self._shots)
        return there[int(torch.randint(len(there), (1,), generator=generator))]


_MEMORY = 0.7  # of the old estimate, when a cell is observed again
_LEAST_SIDE = 48  # pixels of a crop
_MOST = 1e12  # mean squared error that is believed of a checkpoint: their sum has to be a number


class CropSampler:
    """Running mean squared error of every camera in cells of CELL x CELL pixels, and rectangles drawn from it.

    Args:
        cameras: of the capture; images may differ in size.
        share: probability that a step draws a crop, in [0, 1].
        size: sides of the crop over those of the image, in (0, 1].

    Attributes:
        errors: (rows, columns) float32 by camera, infinite where nothing was drawn yet.
    """

    def __init__(self, cameras: Sequence[Camera], share: float, size: float) -> None:
        self._cameras, self._share, self._size = cameras, share, size
        sizes = [(-(-c.height // CELL), -(-c.width // CELL)) for c in cameras]
        self.errors = [np.full(size, np.inf, np.float32) for size in sizes]

    def pick(self, camera: int, generator: torch.Generator) -> tuple[int, int, int, int] | None:
        """(left, top, width, height) in pixels, or None for the whole image. Its centre falls into a cell with the
        probability of that cell's share of the squared error."""
        if self._share == 0.0 or float(torch.rand(1, generator=generator)) >= self._share:
            return None
        errors = self.errors[camera]
        if not np.isfinite(errors).all():  # not drawn whole yet
            return None
        weights = torch.from_numpy(errors.ravel() + 1e-12)
        cell = int(torch.multinomial(weights, 1, generator=generator))
        row, column = divmod(cell, errors.shape[1])
        left, width = self._interval(column, self._cameras[camera].width)
        top, height = self._interval(row, self._cameras[camera].height)
        return left, top, width, height

    def _interval(self, cell: int, length: int) -> tuple[int, int]:
        """Start and length in pixels, whole cells around ``cell`` (the image's last cell may be cut)."""
        cells = -(-length // CELL)
        side = min(cells, max(_LEAST_SIDE // CELL, round(cells * self._size)))
        first = min(max(cell - side // 2, 0), cells - side)
        return first * CELL, min(length, (first + side) * CELL) - first * CELL

    def observe(self, camera: int, region: tuple[int, int, int, int], cells: torch.Tensor) -> None:
        """Adds what a step drew: mean squared errors (rows, columns) of the region's cells, on the CPU."""
        new, row, column = cells.numpy(), region[1] // CELL, region[0] // CELL
        known = self.errors[camera][row : row + new.shape[0], column : column + new.shape[1]]
        known[...] = np.where(np.isfinite(known), _MEMORY * known + (1 - _MEMORY) * new, new)

    def state(self) -> tuple[Tensors, Values]:
        """See Stateful."""
        return {f"regions.{camera}": torch.from_numpy(errors) for camera, errors in enumerate(self.errors)}, {}

    def load_state(self, tensors: Tensors, values: Values) -> None:
        """See Stateful."""
        restored = [expect("errors", tensors[f"regions.{i}"], own.shape) for i, own in enumerate(self.errors)]
        self.errors = [errors.numpy() for errors in restored]
        if not all(((restored >= 0) & ((restored < _MOST) | np.isinf(restored))).all() for restored in self.errors):
            raise ValueError("errors below zero, or larger than any")


_UNDOUBTED = 0.5  # seconds, which a step may take on a computer that has other things to do


def worked(passed: float, computed: float) -> float:
    """Seconds of work in so many seconds, during which the process took ``computed`` seconds of processors.

    What computes takes at least as much time of processors as of the clock, and a process that is stopped (Ctrl-Z, a
    laptop's lid) takes none.
    """
    return passed if passed <= _UNDOUBTED else min(passed, max(_UNDOUBTED, computed))
