"""What every method is to the trainer: canonical Gaussians and a way to move them through time."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import TypeVar

import numpy as np
import torch
from torch import nn

from ..arrays import SceneArrays
from ..capture.camera import Camera
from ..gaussians import TorchGaussians
from ..io.plain_values import JsonObject
from ..rasterizer import Backend, Image, RasterizeOptions, rasterize
from ..rasterizer.cuda import PairRoom
from .canonical import ATTRIBUTES, CanonicalField


@dataclass(frozen=True)
class ScheduleState:
    """How far the schedules inside a model have come; the first two from 0 to 1 (1 in a finished scene).

    Attributes:
        fine_rows: the fine embedding's rows grow from the coarse to all (E-D3DGS's coarse-to-fine schedule).
        opacity: how far the opacity reduction is ramped in.
        sh_count: coefficients of colour that have begun, from the first; None for all.
    """

    fine_rows: float = 1.0
    opacity: float = 1.0
    sh_count: int | None = None


FINISHED = ScheduleState()

Deformed = tuple[TorchGaussians, dict[str, torch.Tensor]]
"""Gaussians at a time, and the changes (M, size) by attribute of those that move, means in world units; {} where a
method has none."""


@dataclass(frozen=True)
class RenderResult:
    """An image, and what it was drawn from.

    Attributes:
        image: what was drawn.
        gaussians, changes: as they were drawn, see ``SceneModel.deform``.
    """

    image: Image
    gaussians: TorchGaussians
    changes: dict[str, torch.Tensor]

    @property
    def state(self) -> torch.Tensor | None:
        """See ``RasterPass.state``; None where automatic differentiation keeps the drawing."""
        return None

    def backward(self, by_rgb: torch.Tensor, by_alpha: torch.Tensor | None = None) -> None:
        """Adds the gradients that (H, W, 3) by the image's colours, and (H, W) by its alpha, bring to those of
        everything it was drawn from."""
        if by_alpha is None:
            self.image.rgb.backward(by_rgb)
        else:
            torch.autograd.backward([self.image.rgb, self.image.alpha], [by_rgb, by_alpha])


class SceneModel(nn.Module):
    """A method: ``deform`` gives the Gaussians at a time in [0, 1].

    Methods share the canonical field, the rasterizer, the losses and the trainer; a method is what it does in
    ``deform`` and the parameters it does it with.

    Attributes:
        canonical: the Gaussians before deformation.
        pair_room: of the drawings that are learned from, on a GPU; their number of pairs is not waited for.
        backend: what draws; None for the fastest that the tensors' device and type allow. With a backend of its own a
            model is computed by torch alone, without the native library.
    """

    canonical: CanonicalField
    pair_room: PairRoom | None = None
    backend: Backend | None = None

    def deform(self, time: float, schedule_state: ScheduleState = FINISHED) -> Deformed:
        """The Gaussians at ``time``, with the coefficients of colour that have begun."""
        raise NotImplementedError

    def draw(
        self,
        time: float,
        camera: Camera,
        background: tuple[float, float, float],
        options: RasterizeOptions,
        schedule_state: ScheduleState = FINISHED,
        *,
        pose: torch.Tensor | None = None,
    ) -> RenderResult:
        """An image at ``time``, differentiable in the model's parameters and in ``pose``; for the arguments
        see ``deform`` and ``rasterizer.rasterize``."""
        gaussians, changes = self.deform(time, schedule_state)
        image = rasterize(gaussians, camera, background, options, pose=pose, backend=self.backend)
        return RenderResult(image, gaussians, changes)

    def rate_groups(self) -> dict[str, list[nn.Parameter]]:
        """Parameters beyond the canonical field's, by the rate that drives them: "temporal", "network" or "grid"."""
        return {}

    def regularization(self) -> torch.Tensor | None:
        """A loss of the method's own, weighted."""
        return None

    def stored_settings(self, schedule_state: ScheduleState) -> JsonObject:
        """Plain values that playback needs, with the schedules as they stand at the end."""
        return {}


class Static(SceneModel):
    """3D Gaussian Splatting without time, the floor that every dynamic method must beat: the canonical Gaussians."""

    def __init__(self, canonical: CanonicalField) -> None:
        super().__init__()
        self.canonical: CanonicalField = canonical

    def deform(self, time: float, schedule_state: ScheduleState = FINISHED) -> Deformed:
        """See SceneModel; nothing changes."""
        return self.canonical.gaussians(schedule_state.sh_count), {}


Model = TypeVar("Model", bound=SceneModel)


def restored(build: Callable[[CanonicalField], Model], arrays: SceneArrays) -> Model:
    """A finished scene's model, on the CPU and without gradients.

    Args:
        build: makes a model of its canonical Gaussians, with any parameters.
        arrays: the scene file's; what is not the model's is left out.

    Raises:
        KeyError, RuntimeError: an array is missing, or has another shape than the model's.
    """
    values = {name: torch.from_numpy(np.array(array, np.float32)) for name, array in arrays.items()}
    state = {
        f"canonical.{name}" if name in ATTRIBUTES else name.replace("network.", "deformation."): value
        for name, value in values.items()
    }
    model = build(CanonicalField(values))
    if missing := model.load_state_dict(state, strict=False, assign=True).missing_keys:
        raise KeyError(missing[0])
    return model.requires_grad_(False)
