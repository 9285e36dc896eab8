"""Aggressive opacity reduction (FRoG, section of that name): opacity = sigmoid(logit + d) * factor(k d)."""

from __future__ import annotations

import torch


def reduction_factor(d_opacity: torch.Tensor, form: str, sharpness: float, share: float = 1.0) -> torch.Tensor:
    """(N,) factor in (0, 1] on the deformed opacity.

    Args:
        d_opacity: (N,) change of the opacity logit.
        form: "paper" is the formula as printed, sigmoid(k d), which is one half where nothing changes; "unit" is
            min(1, 2 sigmoid(k d)), one where nothing changes; "off" is one.
        sharpness: the paper's k.
        share: 0 to 1, how far the factor is ramped in: 1 + share (factor - 1).
    """
    if form == "off" or share == 0.0:
        return torch.ones_like(d_opacity)
    factor = torch.sigmoid(sharpness * d_opacity)
    if form == "unit":
        factor = (2 * factor).clamp(max=1.0)
    return factor if share == 1.0 else 1 + share * (factor - 1)
