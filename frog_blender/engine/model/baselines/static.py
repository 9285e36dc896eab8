"""3D Gaussian Splatting without time: the floor that every dynamic method must beat."""

from __future__ import annotations

import torch

from ...rasterizer import GaussianArrays
from ..canonical import CanonicalField
from ..interface import FINISHED, SceneModel, ScheduleState


class Static(SceneModel):
    """The canonical Gaussians at every time."""

    def __init__(self, canonical: CanonicalField) -> None:
        super().__init__()
        self.canonical: CanonicalField = canonical

    def deform(
        self, time: float, schedule_state: ScheduleState = FINISHED, sh_count: int | None = None
    ) -> tuple[GaussianArrays, dict[str, torch.Tensor]]:
        """See SceneModel; nothing changes."""
        return self.canonical.gaussians(sh_count), {}
