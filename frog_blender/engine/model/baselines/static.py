"""3D Gaussian Splatting without time: the floor that every dynamic method must beat."""

from __future__ import annotations

import torch
from torch import nn

from ...rasterizer import GaussianArrays
from ..canonical import CanonicalField
from ..frog import FINISHED, Progressing


class Static(nn.Module):
    """The canonical Gaussians at every time."""

    def __init__(self, canonical: CanonicalField) -> None:
        super().__init__()
        self.canonical: CanonicalField = canonical

    def deform(
        self, time: float, progressing: Progressing = FINISHED, sh_count: int | None = None
    ) -> tuple[GaussianArrays, dict[str, torch.Tensor]]:
        """As ``Frog.deform``; nothing changes."""
        return self.canonical.gaussians(sh_count), {}

    def forward(self, time: float, progressing: Progressing = FINISHED) -> GaussianArrays:
        return self.canonical.gaussians()
