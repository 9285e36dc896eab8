"""The loss as people see it, a running mean, and the check that it is finite."""

from __future__ import annotations

import math

import torch

from ...errors import FrogError


class TrainingDiverged(FrogError):
    """The loss or a parameter is not finite; see session.recovery."""


_SHARE = 0.02  # of a new value in the mean
_PATIENCE = 20  # steps between two checks of a loss on a GPU


class RunningLoss:
    """On the CPU every loss is checked, before it reaches the optimiser.

    On a GPU a check waits for everything that was queued, and the GPU idles until the next step is queued; so the mean
    stays there and is checked now and then. Nothing is missed: a mean that is not finite never becomes finite again.
    What is saved or shown is checked before (``check``, ``mean``).
    """

    def __init__(self) -> None:
        self._mean: float | torch.Tensor | None = None
        self._unchecked = 0

    @property
    def mean(self) -> float:
        """NaN before the first step."""
        return math.nan if self._mean is None else float(self._mean)

    def resume(self, mean: float) -> None:
        """Goes on from a checkpoint's mean; NaN where it had none."""
        self._mean, self._unchecked = None if math.isnan(mean) else mean, 0

    def add(self, loss: torch.Tensor, step: int) -> None:
        """Adds the loss of step number ``step``; TrainingDiverged when it is found not to be finite."""
        if loss.device.type == "cpu":
            value: float | torch.Tensor = loss.item()
            if not math.isfinite(value):
                raise _unstable(step)
        else:
            value = loss.detach()
            self._unchecked += 1
        self._mean = value if self._mean is None else (1 - _SHARE) * self._mean + _SHARE * value
        if self._unchecked >= _PATIENCE:
            self.check(step)

    def check(self, step: int) -> None:
        """TrainingDiverged when a loss that was not checked yet is not finite."""
        if self._unchecked and not math.isfinite(self.mean):
            raise _unstable(step)
        self._unchecked = 0


def _unstable(step: int) -> TrainingDiverged:
    return TrainingDiverged(f"Training became unstable at step {step} (the loss is not a number).")
