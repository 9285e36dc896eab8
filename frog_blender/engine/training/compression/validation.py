"""Validation: training images that decide what may be taken from a model, and are not learned from for a while before.

Never a held-out image: those are for people afterwards.
"""

import math
from collections.abc import Callable, Sequence
from functools import cached_property
from itertools import pairwise

import numpy as np
import torch
from numpy.typing import NDArray

from ...capture.capture import Capture
from ...gaussians import TorchGaussians
from ...rasterizer import rasterize
from ..optimize.mattes import Mattes

_SHARE = 0.06
_LEAST, _MOST = 4, 8
_ENOUGH = 0.75  # of what may be lost: good enough
_TOO_MUCH, _TOO_LITTLE = 16.0, 64.0  # times is expected at most; too little while a model has hardly begun to learn
_TOGETHER = 8.0  # times the sum of what each costs, cost all of them: similar errors lie in the same places
_FEW = 20  # training images: with fewer none is for validation


def validation_shots(capture: Capture, seed: int) -> tuple[int, ...]:
    """Training shots, spread over the frames, cameras at random; none where there are few."""
    training = capture.train_indices
    if len(training) < _FEW:
        return ()
    random = np.random.default_rng([seed, 5])
    training.sort(key=lambda i: (capture.shots[i].frame, random.random()))
    count = min(max(round(_SHARE * len(training)), _LEAST), _MOST)
    edges = np.linspace(0, len(training), count + 1).astype(int)
    return tuple(sorted(training[int(random.integers(a, b))] for a, b in pairwise(edges)))


class ValidationEvaluator:
    """PSNR of Gaussians on some shots, as they stand and as they are proposed.

    Args:
        mattes: the capture's images.
        shots: to compare with.
        gaussians_at: the Gaussians at a time in [0, 1], as they stand.
    """

    def __init__(
        self, capture: Capture, mattes: Mattes, shots: Sequence[int], gaussians_at: Callable[[float], TorchGaussians]
    ) -> None:
        self._capture, self._mattes, self._shots, self._gaussians_at = capture, mattes, shots, gaussians_at
        self._gaussians: dict[int, TorchGaussians] = {}  # as they stand, by shot

    @cached_property
    def now(self) -> float:
        """PSNR as the Gaussians stand."""
        return self._psnr(lambda gaussians: gaussians)

    def loss(self, change: Callable[[TorchGaussians], TorchGaussians]) -> float:
        """How many dB ``change`` costs on average; negative where it gains."""
        return self.now - self._psnr(change)

    def expected(self, energies: torch.Tensor) -> NDArray[np.float64]:
        """(N,) dB that the first change costs, the first two and so on, about.

        Args:
            energies: (N,) by how much an image changes with each alone: sum of squares over pixels and channels.
        """
        together = _TOGETHER * energies.double().cumsum(0).cpu().numpy()
        return np.asarray(10 * np.log10(1 + together / self._squares()))

    def energy_of(self, loss: float) -> float:
        """See ``expected``: of a change that alone costs about ``loss`` dB."""
        return float((10 ** (loss / 10) - 1) * self._squares() / _TOGETHER)

    def _squares(self) -> float:
        """The error of a mean image, summed over its pixels and channels."""
        cameras = [self._capture.cameras[self._capture.shots[index].camera] for index in self._shots]
        return float(10 ** (-self.now / 10) * 3 * np.mean([camera.width * camera.height for camera in cameras]))

    def accept(self, loss: float) -> None:
        """The Gaussians have been changed, for ``loss`` dB."""
        self.now -= loss
        self._gaussians = {}

    @torch.no_grad()
    def _psnr(self, change: Callable[[TorchGaussians], TorchGaussians]) -> float:
        """Mean over the shots after ``change``."""
        values, capture, mattes = [], self._capture, self._mattes
        if not self._gaussians:
            times = {index: capture.time_of(capture.shots[index]) for index in self._shots}
            self._gaussians = {index: self._gaussians_at(time) for index, time in times.items()}
        for position, (index, gaussians) in enumerate(self._gaussians.items()):
            camera = capture.cameras[capture.shots[index].camera]
            target = mattes.truth(index, camera, background=mattes.background_of(position))
            values.append(target.psnr(rasterize(change(gaussians), camera, target.background).rgb))
        return float(np.mean(values))


def largest_count_within(
    loss: Callable[[int], float], expected: NDArray[np.float64], allowed: float, tries: int = 6
) -> tuple[int, float]:
    """About the largest number of candidates, from the first, whose loss is allowed: (number, its loss).

    Bisects the logarithm of what is expected, from what is allowed / ``_TOO_LITTLE`` to ``_TOO_MUCH`` times as much.

    Args:
        loss: of that many candidates; grows with them.
        expected: (candidates,) ascending, what it is about.
        tries: calls of ``loss`` at most; fewer where one finds ``_ENOUGH`` of what is allowed.
    """
    low, cost, high = 0, 0.0, len(expected) + 1
    least, most = max(allowed, 0.0) / _TOO_LITTLE, max(allowed, 0.0) * _TOO_MUCH
    for _ in range(tries):
        aim = math.sqrt(least * most)
        taken = max(1, int(np.searchsorted(expected, aim, side="right")))  # one is worth a look in any case
        if low < taken < high:
            if (lost := loss(taken)) <= allowed:
                low, cost = taken, lost
            else:
                high = taken
        if cost > _ENOUGH * allowed:
            break
        least, most = (aim, most) if taken <= low else (least, aim)
    return low, cost
