"""Where in a picture a step looks: most steps draw only a rectangle of it, chosen where the errors are.

A picture's still part is learned long before its moving part, yet costs most of every step. A step on a rectangle costs
little more than its share of the pixels, so the same time holds several times the steps where they are needed.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch.nn import functional

from ..capture.camera import Camera
from .device import OnItsWay
from .fitting import fitting

CELL = 16  # pixels a side; the rasterizer's tiles
_MEMORY = 0.7  # share of the old estimate that a new look at a cell leaves
_LEAST = 48  # pixels a side


@dataclass(frozen=True)
class _Look:
    """Mean squared error by cell (rows, columns) of a camera's region."""

    camera: int
    region: tuple[int, int, int, int]
    mean: OnItsWay


class RegionPicker:
    """Running mean squared error of every camera in cells of 16 x 16 pixels, and rectangles drawn from it.

    Args:
        cameras: of the capture; pictures may differ in size.
        share: probability that a step looks at a rectangle, in [0, 1].
        size: sides of the rectangle over those of the picture, in (0, 1].

    Attributes:
        errors: (rows, columns) by camera, infinite where nothing was drawn yet; on the CPU, where rectangles are drawn.
            ``settle`` first.
    """

    def __init__(self, cameras: tuple[Camera, ...] | list[Camera], share: float, size: float) -> None:
        self._cameras, self._share, self._size = cameras, share, size
        sizes = [(-(-c.height // CELL), -(-c.width // CELL)) for c in cameras]
        self.errors = [torch.full(size, torch.inf, device="cpu") for size in sizes]
        self._arriving: list[_Look] = []

    def pick(self, camera: int, generator: torch.Generator) -> tuple[int, int, int, int] | None:
        """(left, top, width, height) in pixels, or None for the whole picture. Its centre falls into a cell with the
        probability of that cell's share of the squared error."""
        if self._share == 0.0 or float(torch.rand(1, generator=generator)) >= self._share:
            return None
        self.settle()
        errors = self.errors[camera]
        if not bool(torch.isfinite(errors).all()):  # its first time: all of it
            return None
        cell = int(torch.multinomial(errors.flatten() + 1e-12, 1, generator=generator))
        row, column = divmod(cell, errors.shape[1])
        left, width = self._interval(column, self._cameras[camera].width)
        top, height = self._interval(row, self._cameras[camera].height)
        return left, top, width, height

    def _interval(self, cell: int, length: int) -> tuple[int, int]:
        """Start and length in pixels, whole cells around ``cell`` (the picture's last cell may be cut)."""
        cells = -(-length // CELL)
        wanted = min(cells, max(_LEAST // CELL, round(cells * self._size)))
        first = min(max(cell - wanted // 2, 0), cells - wanted)
        return first * CELL, min(length, (first + wanted) * CELL) - first * CELL

    @torch.no_grad()
    def observe(self, camera: int, region: tuple[int, int, int, int], difference: torch.Tensor) -> None:
        """Takes in what a step saw: ``difference`` (height, width, 3), picture minus truth, of the region."""
        square = difference[::2, ::2].square().permute(2, 0, 1)  # a quarter of the pixels tells as much
        mean = functional.avg_pool2d(square, CELL // 2, ceil_mode=True, count_include_pad=False).mean(0)
        self.settle()  # what came before has long arrived; this is fetched by the next step, and nothing waits for it
        self._arriving.append(_Look(camera, region, OnItsWay(mean)))

    def settle(self) -> None:
        """Takes in what is still on its way."""
        for look in self._arriving:
            self._take_in(look)
        self._arriving.clear()

    def resume(self, errors: list[torch.Tensor]) -> None:
        """Goes on from a checkpoint's errors and forgets what is on its way; ValueError for what does not fit."""
        sizes = [tuple(own.shape) for own in self.errors]
        self.errors = [fitting("errors", *pair) for pair in zip(errors, sizes, strict=True)]
        if any(bool((found < 0).any()) for found in errors):
            raise ValueError("errors below zero")
        self._arriving.clear()

    def _take_in(self, look: _Look) -> None:
        mean = look.mean.here()
        row, column = look.region[1] // CELL, look.region[0] // CELL
        cells = self.errors[look.camera][row : row + mean.shape[0], column : column + mean.shape[1]]
        cells.copy_(torch.where(torch.isfinite(cells), _MEMORY * cells + (1 - _MEMORY) * mean, mean))
