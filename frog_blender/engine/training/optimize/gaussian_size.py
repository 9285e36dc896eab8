"""How large Gaussians may be.

An image says how wide a Gaussian is, not how deep: what reaches behind an edge that no training image looks behind
shows as a fringe from the next side (the size regularization of 3DGS-MCMC, Kheradmand 2024, keeps it small). And what
is so large that it wraps the cameras backs all walls with one colour, which is a fog from anywhere else.
"""

from __future__ import annotations

import numpy as np
import torch

from ...capture.capture import Capture
from ...model.canonical import CanonicalField


@torch.no_grad()
def add_size_gradient(canonical: CanonicalField, weight: float, unit: float) -> None:
    """Adds to the log scales' gradient that of ``weight`` times the mean standard deviation over all Gaussians and
    axes; nothing where a step has seen none of them.

    Args:
        unit: world units, which the standard deviations are divided by.
    """
    log_scales = canonical.log_scales
    if log_scales.grad is not None and log_scales.numel():
        log_scales.grad.add_(log_scales.exp(), alpha=weight / (unit * log_scales.numel()))


@torch.no_grad()
def limit_sizes(canonical: CanonicalField, capture: Capture, share: float, nearest: float) -> None:
    """Shrinks what has a standard deviation of more than ``share`` of its distance to the nearest training camera.

    Args:
        nearest: world units, which every distance is taken for at least.
    """
    means, log_scales = canonical.means, canonical.log_scales
    distances = torch.full((len(means),), torch.inf, dtype=means.dtype, device=means.device)
    places = np.array([capture.cameras[index].center for index in capture.train_cameras], np.float32)
    for center in torch.from_numpy(places).to(means.device, non_blocking=True):
        torch.minimum(distances, (means - center).norm(dim=1), out=distances)
    most = (share * distances.clamp(min=nearest)).log()[:, None]
    log_scales.copy_(torch.minimum(log_scales, most))
