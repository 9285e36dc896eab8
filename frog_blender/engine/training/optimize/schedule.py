"""What is due when, and which image comes next."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import torch

from ...capture.capture import Capture
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


_NEVER_DRAWN = 100.0  # no image in [0, 1] can lose as much
_MOST = 1e12  # of what a checkpoint may say


class ViewSampler:
    """Draws training images; never one that is excluded for validation.

    Args:
        choice: "even": each as often as every other. "loss": every second draw picks its frame in proportion to the
            frame's last loss, summed over the cameras (E-D3DGS, its loss-based frame sampling); frames that were not
            drawn yet come first.

    Attributes:
        draws: so far.
        losses: (cameras, frames) mean absolute error when drawn last, ``_NEVER_DRAWN`` before the first time.
    """

    def __init__(self, capture: Capture, choice: str = "even") -> None:
        self._by_loss = choice == "loss"
        self.draws = 0
        self.losses = torch.full((len(capture.cameras), capture.frame_count), _NEVER_DRAWN, device="cpu")
        self._capture = capture
        self._excluded: Sequence[int] = ()
        self._gather()

    def _gather(self) -> None:
        shots = self._capture.shots
        self._shots = [i for i in self._capture.train_indices if i not in self._excluded]
        self._by_frame: dict[int, list[int]] = {}
        for i in self._shots:
            self._by_frame.setdefault(shots[i].frame, []).append(i)

    def state(self) -> tuple[Tensors, Values]:
        """See Stateful."""
        return {"losses": self.losses}, {"draws": self.draws}

    def load_state(self, tensors: Tensors, values: Values) -> None:
        """See Stateful."""
        losses, draws = tensors["losses"], int(values["draws"])
        self.losses = expect("losses", losses, tuple(self.losses.shape))
        if not bool(((losses >= 0) & (losses < _MOST)).all()) or not 0 <= draws < _MOST:
            raise ValueError("losses or draws that no training has")
        self.draws = draws

    def exclude(self, shots: Sequence[int]) -> None:
        """From now on draws none of these training shots, and all others."""
        if shots != self._excluded:
            self._excluded = shots
            self._gather()

    def pick(self, generator: torch.Generator) -> int:
        """A shot index."""
        self.draws += 1
        if self._by_loss and self.draws % 2 == 0:
            return self._pick_by_loss(generator)
        return self._shots[int(torch.randint(len(self._shots), (1,), generator=generator))]

    def _pick_by_loss(self, generator: torch.Generator) -> int:
        frames = sorted(self._by_frame)
        by_frame = self.losses[:, frames].sum(0)
        weights = by_frame - by_frame.min() + 1e-6 * by_frame.max() + 1e-12
        there = self._by_frame[frames[int(torch.multinomial(weights, 1, generator=generator))]]
        return there[int(torch.randint(len(there), (1,), generator=generator))]

    def observe(self, shot: int, error: torch.Tensor) -> None:
        """Adds the mean absolute error () of a drawn image."""
        if self._by_loss:
            drawn = self._capture.shots[shot]
            self.losses[drawn.camera, drawn.frame] = error.cpu()

    def pick_same_frame(self, shot: int, generator: torch.Generator) -> int:
        """Another camera at the frame of ``shot`` (the same image when there is only one); any image when all of that
        frame are excluded."""
        there = self._by_frame.get(self._capture.shots[shot].frame, self._shots)
        return there[int(torch.randint(len(there), (1,), generator=generator))]
