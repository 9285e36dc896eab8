"""Adds the changes that a baseline's network gives to the canonical Gaussians."""

from __future__ import annotations

import torch

from ...gaussians import TorchGaussians
from ...rasterizer import GaussianArrays
from ..canonical import CanonicalField


def deformed(
    canonical: CanonicalField, changes: dict[str, torch.Tensor], sh_count: int | None = None
) -> TorchGaussians:
    """The activated Gaussians with ``changes`` added before activation.

    Args:
        changes: (N, size) by attribute; "means" (world units), "log_scales", "quaternions", "opacity_logits" (N, 1)
            and "sh" (N, 3 C) for the first C coefficients, each of which may be missing.
        sh_count: coefficients that come out, from the first; None for all.
    """
    c = canonical
    log_scales, opacity_logits, sh = c.log_scales, c.opacity_logits, c.sh
    if "log_scales" in changes:
        log_scales = log_scales + changes["log_scales"]
    if "opacity_logits" in changes:
        opacity_logits = opacity_logits + changes["opacity_logits"].squeeze(1)
    if "sh" in changes:
        d_sh = changes["sh"].reshape(len(c), -1, 3)
        count = d_sh.shape[1]
        sh = torch.cat([sh[:, :count] + d_sh, sh[:, count:]], dim=1)
    return GaussianArrays(
        c.means + changes["means"],
        c.quaternions + changes["quaternions"],
        log_scales.exp(),
        opacity_logits.sigmoid(),
        sh[:, :sh_count],
    )


def bounds_of(points: torch.Tensor, margin: float = 0.1) -> tuple[torch.Tensor, torch.Tensor]:
    """Lower and upper corner (3,), on the CPU, of a box that a few stray points cannot blow up.

    From the first to the ninety-ninth hundredth of each coordinate, and ``margin`` of its sides more on each side.
    """
    ordered = points.detach().cpu().sort(dim=0).values
    last = len(ordered) - 1
    low, high = ordered[round(0.01 * last)], ordered[round(0.99 * last)]
    room = margin * (high - low) + 1e-6 * (1 + low.abs())  # never flat
    return low - room, high + room
