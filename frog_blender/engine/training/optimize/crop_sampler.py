"""Where in an image a step looks: most steps draw only a rectangle of it, chosen where the errors are.

An image's still part is learned long before its moving part, yet costs most of every step. A step on a rectangle costs
little more than its share of the pixels, so the same time holds several times the steps where they are needed.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch

from ...capture.camera import Camera
from ...native.binding import CELL
from .device import OnItsWay
from .state_checks import fitting

_MEMORY = 0.7  # share of the old estimate that a new look at a cell leaves
_LEAST = 48  # pixels a side
_MOST = 1e12  # mean squared error that is believed of a checkpoint: their sum has to be a number


@dataclass(frozen=True)
class _Look:
    """Mean squared errors (rows, columns) of a camera's region."""

    camera: int
    region: tuple[int, int, int, int]
    cells: OnItsWay


class CropSampler:
    """Running mean squared error of every camera in cells of CELL x CELL pixels, and rectangles drawn from it.

    Args:
        cameras: of the capture; images may differ in size.
        share: probability that a step looks at a rectangle, in [0, 1].
        size: sides of the rectangle over those of the image, in (0, 1].

    Attributes:
        errors: (rows, columns) float32 by camera, infinite where nothing was drawn yet. ``settle`` first.
    """

    def __init__(self, cameras: tuple[Camera, ...] | list[Camera], share: float, size: float) -> None:
        self._cameras, self._share, self._size = cameras, share, size
        sizes = [(-(-c.height // CELL), -(-c.width // CELL)) for c in cameras]
        self.errors = [np.full(size, np.inf, np.float32) for size in sizes]
        self._arriving: list[_Look] = []

    def pick(self, camera: int, generator: torch.Generator) -> tuple[int, int, int, int] | None:
        """(left, top, width, height) in pixels, or None for the whole image. Its centre falls into a cell with the
        probability of that cell's share of the squared error."""
        if self._share == 0.0 or float(torch.rand(1, generator=generator)) >= self._share:
            return None
        self.settle()
        errors = self.errors[camera]
        if not np.isfinite(errors).all():  # its first time: all of it
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
        wanted = min(cells, max(_LEAST // CELL, round(cells * self._size)))
        first = min(max(cell - wanted // 2, 0), cells - wanted)
        return first * CELL, min(length, (first + wanted) * CELL) - first * CELL

    def observe(self, camera: int, region: tuple[int, int, int, int], cells: torch.Tensor) -> None:
        """Takes in what a step saw: mean squared errors (rows, columns) of the region's cells."""
        self.settle()  # what came before has long arrived; this is fetched by the next step, and nothing waits for it
        self._arriving.append(_Look(camera, region, OnItsWay(cells)))

    def settle(self) -> None:
        """Takes in what is still on its way."""
        for look in self._arriving:
            self._take_in(look)
        self._arriving.clear()

    def resume(self, errors: list[torch.Tensor]) -> None:
        """Goes on from a checkpoint's errors and forgets what is on its way; ValueError for what does not fit."""
        sizes = [own.shape for own in self.errors]
        self.errors = [fitting("errors", *pair).numpy() for pair in zip(errors, sizes, strict=True)]
        if not all(((found >= 0) & ((found < _MOST) | np.isinf(found))).all() for found in self.errors):
            raise ValueError("errors below zero, or larger than any")
        self._arriving.clear()

    def _take_in(self, look: _Look) -> None:
        new = look.cells.here().numpy()
        row, column = look.region[1] // CELL, look.region[0] // CELL
        known = self.errors[look.camera][row : row + new.shape[0], column : column + new.shape[1]]
        known[...] = np.where(np.isfinite(known), _MEMORY * known + (1 - _MEMORY) * new, new)
