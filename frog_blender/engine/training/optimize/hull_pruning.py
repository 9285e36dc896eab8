"""Gaussians outside a subject's visual hull are removed now and then: the loss alone leaves faint ones behind."""

from __future__ import annotations

import numpy as np
import torch

from ...capture.capture import Capture
from ...capture.frames import FrameStore
from ...capture.hull import ALL_BUT, VisualHull
from ...capture.seeding.views import spread
from .hooks import Hook, Training
from .schedule import Every

_FROM, _UNTIL, _EVERY = 0.1, 0.99, 0.08  # of the training
_MOST_TIMES, _MOST_SINGLE = 12, 48  # frames that are looked at
_SEEN = 0.02  # opacity: what is fainter at a time is not there


class HullPruning(Hook):
    """Removes what is outside the hull, in world space and as it is deformed, for more than ALL_BUT of the time for
    which it can be seen, weighted by its opacity.

    Args:
        capture: with masks.
        store: with their alpha.
    """

    def __init__(self, capture: Capture, store: FrameStore) -> None:
        frames = sorted({capture.shots[index].frame for index in capture.train_indices})
        single = len(frames) == len(capture.train_indices)
        chosen = set(spread(frames, _MOST_SINGLE if single else _MOST_TIMES))
        shots = [index for index in capture.train_indices if capture.shots[index].frame in chosen]
        self._hull = VisualHull(capture, store, shots)
        self._due = Every(_FROM, _UNTIL, _EVERY)

    def after_step(self, training: Training, before: float, now: float) -> None:
        """Prunes where that is due in (before, now]."""
        if not self._due.due(before, now) or not self._hull.frames:
            return
        keep = self.inside(training)
        if keep.any() and not keep.all():
            training.gaussians.keep(keep.nonzero().squeeze(1))

    @torch.no_grad()
    def inside(self, training: Training) -> torch.Tensor:
        """(N,) bool, on the Gaussians' device, which may stay."""
        count = training.gaussians.count
        outside, visible, ever = np.zeros(count), np.zeros(count), np.zeros(count, bool)
        for frame in self._hull.frames:
            gaussians = training.deform(self._hull.time_of(frame))[0]
            inside, seen = self._hull.contains_at(gaussians.means.detach().cpu().double().numpy(), frame)
            weight = gaussians.opacities.detach().cpu().double().numpy().reshape(-1)
            weight = np.where(weight > _SEEN, weight, 0.0)
            outside += weight * (seen & ~inside)
            visible += weight * seen
            ever |= seen
        keep = ever & (outside <= ALL_BUT * visible)
        return torch.from_numpy(keep).to(training.gaussians.device)


def hull_hooks(capture: Capture, store: FrameStore) -> list[Hook]:
    """What a trainer of a capture with masks needs besides; nothing where the images are whole."""
    has_alpha = capture.has_masks and store.alpha(0) is not None
    return [HullPruning(capture, store)] if has_alpha else []
