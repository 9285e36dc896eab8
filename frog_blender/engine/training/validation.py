"""Training pictures that nothing is learned from while the model's capacity is being settled: reductions' judges.

Never a test picture: those are for people to look at afterwards.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import pairwise

import numpy as np
import torch

from ..capture.capture import Capture
from ..capture.frames import FrameStore
from ..evaluation.metrics import psnr_of
from ..rasterizer import GaussianArrays, rasterize
from .device import picture_on

_SHARE = 0.06
_LEAST, _MOST = 4, 8
_FEW = 20  # training pictures: with fewer none is spared


def withheld_shots(capture: Capture, seed: int) -> tuple[int, ...]:
    """Shots of the training's share, spread over the moments, cameras at random; none where there are few."""
    training = capture.train_indices
    if len(training) < _FEW:
        return ()
    random = np.random.default_rng([seed, 5])
    training.sort(key=lambda i: (capture.shots[i].frame, random.random()))
    count = min(max(round(_SHARE * len(training)), _LEAST), _MOST)
    edges = np.linspace(0, len(training), count + 1).astype(int)
    return tuple(sorted(training[int(random.integers(a, b))] for a, b in pairwise(edges)))


class Judge:
    """PSNR of proposed Gaussians on some shots.

    Args:
        shots: what to look at.
        gaussians_of: the Gaussians at a shot's moment, as they stand.
    """

    def __init__(
        self, capture: Capture, store: FrameStore, shots: Sequence[int], gaussians_of: Callable[[int], GaussianArrays]
    ) -> None:
        self._capture, self._store = capture, store
        with torch.no_grad():
            self._drawn = {index: gaussians_of(index) for index in shots}
        self.before = self.psnr(lambda gaussians: gaussians)

    def loss(self, change: Callable[[GaussianArrays], GaussianArrays]) -> float:
        """How many dB ``change`` costs on average; negative where it gains."""
        return self.before - self.psnr(change)

    @torch.no_grad()
    def psnr(self, change: Callable[[GaussianArrays], GaussianArrays]) -> float:
        """Mean over the shots after ``change``."""
        values = []
        for index, gaussians in self._drawn.items():
            camera = self._capture.cameras[self._capture.shots[index].camera]
            image = rasterize(change(gaussians), camera, self._capture.background)
            truth = picture_on(image.rgb.device, self._store.image(index))
            values.append(psnr_of(float((image.rgb.clamp(0, 1) - truth).square().mean())))
        return float(np.mean(values))


def most_within(
    loss: Callable[[int], float], candidates: int, allowed: float, first: int | None = None, tries: int = 4
) -> tuple[int, float]:
    """About the largest number of candidates, from the first, whose loss is allowed: (number, its loss).

    Args:
        loss: of that many candidates; grows with them.
        first: what to try first; all of them when None.
        tries: calls of ``loss`` at most.
    """
    low, cost, high = 0, 0.0, candidates + 1
    number = candidates if first is None else min(first, candidates)
    for _ in range(tries):
        if number <= low or number >= high:
            break
        found = loss(number)
        if found <= allowed:
            low, cost = number, found
            number = min(2 * number, candidates) if high > candidates else (low + high) // 2
        else:
            high, number = number, (low + number) // 2
    return low, cost
