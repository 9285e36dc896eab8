"""An image of the fused field and its backward pass, by native calls one after the other.

The same bits as ``deform_fused`` and ``rasterize`` with automatic differentiation, which keeps track of some twenty
arrays between them: that takes a tenth of a training's step.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import torch

from ..capture.camera import NEUTRAL, Camera
from ..gaussians import TorchGaussians
from ..native.deformation import FieldShape
from ..rasterizer import RasterizeOptions, exposed
from ..rasterizer.cpu import RasterPass, draw
from .fused import FieldPass, forward_field
from .interface import RenderResult


@dataclass(frozen=True)
class FusedRenderResult(RenderResult):
    """See RenderResult.

    Attributes:
        arrays: what was drawn, by name: parameters, and ``temporal`` with the gradients' way to the table.
        pose: the camera's, to receive its gradient, or None.
        field, drawing: for the backward pass.
        silent_rows: rows of the network's outputs that no gradient passes; None where there are none.
        versions: of arrays and Gaussians, when they were drawn.
    """

    arrays: dict[str, torch.Tensor]
    pose: torch.Tensor | None
    field: FieldPass
    drawing: RasterPass
    silent_rows: slice | None
    versions: list[int]

    def backward(self, by_rgb: torch.Tensor, by_alpha: torch.Tensor | None = None) -> None:
        """See RenderResult; RuntimeError when an array has been changed in place since."""
        if _versions(self.arrays, self.gaussians) != self.versions:
            raise RuntimeError("one of the scene's arrays has been changed since the image was drawn")
        if self.drawing.camera.exposure != NEUTRAL:
            by_rgb = by_rgb * by_rgb.new_tensor(self.drawing.camera.exposure)
        by_gaussians = self.drawing.backward(by_rgb, by_alpha, None if self.pose is None else self.pose.shape)
        self.image.screen.grad = by_gaussians.pop("screen")
        if self.pose is not None:
            self.pose.grad = by_gaussians.pop("pose")
        gradients = self.field.backward(by_gaussians)
        if self.silent_rows is not None:
            for name in ("output_weight", "output_bias"):
                gradients[name][self.silent_rows] = 0
        self.arrays["temporal"].backward(gradients.pop("temporal"))
        for name, gradient in gradients.items():
            parameter = self.arrays[name]
            parameter.grad = gradient if parameter.grad is None else parameter.grad + gradient


def render_fused(
    shape: FieldShape,
    arrays: dict[str, torch.Tensor],
    camera: Camera,
    background: tuple[float, float, float],
    options: RasterizeOptions,
    *,
    pose: torch.Tensor | None,
    silent_rows: slice | None,
    by_attribute: Callable[[torch.Tensor], dict[str, torch.Tensor]],
) -> FusedRenderResult:
    """An image whose colours, alpha and Gaussians are without gradients of their own.

    Args:
        shape, arrays: see ``forward_field``; parameters but for ``temporal``.
        camera, background, options, pose: see ``rasterizer.rasterize``; without ``options.absolute``.
        silent_rows: see FusedRenderResult.
        by_attribute: see DeformationField.
    """
    if pose is not None:
        camera = camera.with_pose(pose.detach().numpy())
    field, gaussians, changes = forward_field(shape, arrays)
    drawing, rgb, alpha = draw(gaussians, camera, background, options)
    screen = torch.empty((len(gaussians), 2), dtype=torch.float32, device="cpu")  # for its gradient alone
    image = exposed(drawing.image(rgb, alpha, screen), camera)
    versions = _versions(arrays, gaussians)
    return FusedRenderResult(
        image, gaussians, by_attribute(changes), arrays, pose, field, drawing, silent_rows, versions
    )


def _versions(arrays: dict[str, torch.Tensor], gaussians: TorchGaussians) -> list[int]:
    """How often each array, and each of what was drawn from them, has been changed in place."""
    return [array._version for array in (*arrays.values(), *vars(gaussians).values())]
