"""Gaussians outside a subject's visual hull are removed now and then: the loss alone leaves faint ones behind."""

import numpy as np
import torch

from ...capture.camera import Camera
from ...capture.capture import Capture
from ...capture.hull import ALL_BUT, VisualHull
from ...capture.seeding.views import spread
from ...frames.store import FrameStore
from .mattes import sampled
from .schedule import Every
from .training import Hook, Training
from .transfers import bytes_on

_FROM, _UNTIL, _EVERY = 0.1, 0.99, 0.08  # of the training
_MOST_TIMES = 48  # frames that are looked at: what shows for a few of them only must not be missed
_STRICT_FROM = 0.6  # share of the training at which motion is learned
_ALL_BUT_FIRST = 0.5  # of single views, before that
_NEVER_INSIDE, _MOSTLY_OUTSIDE = 1 - 1e-6, 0.75  # of a time's several views, before and after
_DENSER = 3.0  # times as many Gaussians a pixel has a subject as a whole image
_FEWEST = 1000  # Gaussians for a subject, however small
_SHARE_OF = 50  # images
_SEEN = 0.02  # opacity: what is fainter at a time is not there


class HullPruning(Hook):
    """Removes what is outside the hull as it is deformed, at all times at which it can be seen: a Gaussian that is
    inside at one time may yet learn to move, or to vanish at the others; once motion is learned, what is outside for
    the most part, weighted by opacity, is none of the subject's. Of single views, each of which leaves room before and
    behind the subject, it removes what is outside in a share of them. For captures whose masks have an alpha.
    """

    def begin(self, training: Training) -> None:
        """A subject that fills a part of the images has the Gaussians of that part, and some for its details."""
        capture, store = training.capture, training.store
        frames = sorted({capture.shots[index].frame for index in capture.train_indices})
        chosen = set(spread(frames, _MOST_TIMES))
        shots = [index for index in capture.train_indices if capture.shots[index].frame in chosen]
        self._hull = hull = VisualHull(capture, store, shots)
        self._views: dict[int, list[tuple[Camera, torch.Tensor]]] = {frame: [] for frame in hull.frames}
        for frame, views in self._views.items():
            for camera, mask in zip(*hull.views_at(frame), strict=True):
                there = bytes_on(training.gaussians.device, mask.view(np.uint8)) > 0
                views.append((camera.resized(mask.shape[1], mask.shape[0]), there))
        self._due = Every(_FROM, _UNTIL, _EVERY)
        training.limit_gaussians(room_for_subject(capture, store, training.recipe.max_gaussians))

    def after_step(self, training: Training, before: float, now: float) -> None:
        """Prunes where that is due in (before, now]."""
        if not self._due.due(before, now) or not self._hull.frames:
            return
        keep = self.inside(training, strict=now >= _STRICT_FROM)
        if keep.any() and not keep.all():
            training.gaussians.keep(keep.nonzero().squeeze(1))

    @torch.no_grad()
    def inside(self, training: Training, *, strict: bool = True) -> torch.Tensor:
        """(N,) bool, on the Gaussians' device, which may stay; ``strict`` where motion is learned."""
        ever = torch.zeros(training.gaussians.count, dtype=torch.bool, device=training.gaussians.device)
        outside = visible = torch.zeros_like(ever, dtype=torch.float64)
        for frame, views in self._views.items():
            gaussians = training.deform(self._hull.time_of(frame))[0]
            means, missed, seen = gaussians.means.double(), torch.zeros_like(ever), torch.zeros_like(ever)
            for camera, mask in views:
                inside, in_view = sampled(mask, means, camera, (0, 0, camera.width, camera.height))
                missed |= in_view & ~inside
                seen |= in_view
            weight = gaussians.opacities.double().reshape(-1)
            weight = torch.where(weight > _SEEN, weight, 0.0)
            outside, visible = outside + weight * missed, visible + weight * seen
            ever |= seen
        single, several = (ALL_BUT, _MOSTLY_OUTSIDE) if strict else (_ALL_BUT_FIRST, _NEVER_INSIDE)
        some = single if self._hull.has_single_views else several
        return ever & (outside <= some * visible)


def room_for_subject(capture: Capture, store: FrameStore, most: int) -> int:
    """Gaussians at most for the subject of a capture, of ``most`` for whole images."""
    if not (capture.has_masks and store.alpha(0) is not None):
        return most
    alphas = [store.alpha(index) for index in spread(capture.train_indices, _SHARE_OF)]
    share = float(np.mean([alpha.mean() / 255 for alpha in alphas if alpha is not None]))
    return min(most, max(_FEWEST, round(_DENSER * share * most)))
