"""What every method is to the trainer: canonical Gaussians and a way to move them through time."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import torch
from torch import nn

from ..capture.camera import Camera
from ..rasterizer import GaussianArrays, Image, RasterizeOptions, rasterize
from .canonical import CanonicalField


@dataclass(frozen=True)
class ScheduleState:
    """How far the schedules inside a model have come, each from 0 to 1 (all 1 in a finished scene).

    Attributes:
        fine_rows: the fine embedding's rows grow from the coarse to all (E-D3DGS's coarse-to-fine schedule).
        opacity: how far the opacity reduction is ramped in.
    """

    fine_rows: float = 1.0
    opacity: float = 1.0


FINISHED = ScheduleState()


@dataclass(frozen=True)
class RenderResult:
    """An image of a moment.

    Attributes:
        image: what was drawn.
        gaussians, changes: as they were drawn, see ``SceneModel.deform``.
    """

    image: Image
    gaussians: GaussianArrays
    changes: dict[str, torch.Tensor]

    def backward(self, by_rgb: torch.Tensor) -> None:
        """Adds the gradients that (H, W, 3) by the image's colours bring to those of everything it was drawn from."""
        self.image.rgb.backward(by_rgb)


class SceneModel(nn.Module):
    """A method: ``model(time)`` gives the Gaussians at a time in [0, 1].

    Methods share the canonical field, the rasterizer, the losses and the trainer; a method is what it does in
    ``deform`` and the parameters it does it with.
    """

    canonical: CanonicalField

    def deform(
        self, time: float, schedule_state: ScheduleState = FINISHED, sh_count: int | None = None
    ) -> tuple[GaussianArrays, dict[str, torch.Tensor]]:
        """The Gaussians at ``time`` and the changes (M, size) by attribute of those that move, means in world units;
        {} where a method has none.

        Args:
            sh_count: coefficients that come out, from the first; None for all.
        """
        raise NotImplementedError

    def draw(
        self,
        time: float,
        camera: Camera,
        background: tuple[float, float, float],
        options: RasterizeOptions,
        schedule_state: ScheduleState = FINISHED,
        sh_count: int | None = None,
        pose: torch.Tensor | None = None,
    ) -> RenderResult:
        """An image of ``time`` that knows its way back, to the model's parameters and to ``pose``; for the arguments
        see ``deform`` and ``rasterizer.rasterize``."""
        gaussians, changes = self.deform(time, schedule_state, sh_count)
        return RenderResult(rasterize(gaussians, camera, background, options, pose=pose), gaussians, changes)

    def forward(self, time: float, schedule_state: ScheduleState = FINISHED) -> GaussianArrays:
        return self.deform(time, schedule_state)[0]

    def rate_groups(self) -> dict[str, list[nn.Parameter]]:
        """Parameters beyond the canonical field's, by the rate that drives them: "temporal", "network" or "grid"."""
        return {}

    def regularization(self) -> torch.Tensor | None:
        """A loss of the method's own, weighted."""
        return None

    def stored_settings(self, schedule_state: ScheduleState) -> dict[str, Any]:
        """Plain values that playback needs, with the schedules as they stand at the end."""
        return {}
