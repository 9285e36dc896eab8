"""Small Gaussians where single views leave their depth open (the size regularization of 3DGS-MCMC, Kheradmand 2024).

An image says how wide a Gaussian is, not how deep: what reaches behind an edge that no training image looks behind
shows as a fringe from the next side.
"""

from __future__ import annotations

import torch

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
