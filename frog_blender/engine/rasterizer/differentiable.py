"""A drawing that was made without automatic differentiation, as a torch operation."""

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass

import torch

from ..capture.camera import Camera
from ..cuda import launch
from ..gaussians import ATTRIBUTES, TorchGaussians
from . import Image
from .torch_types import Context


@dataclass(frozen=True)
class RasterPass(ABC):
    """A drawing, kept for its backward pass, and its outputs besides the image.

    It does not hold the image: each would refer to the other, and neither would be freed.

    Attributes:
        gaussians, camera: what was drawn.
        extras: outputs by name, see native.Frame.
        state: on a GPU (2,) int64: the drawing's (tile, Gaussian) pairs, and 1 if they had no room, so that nothing is
            to be learned from it; else None.
    """

    gaussians: TorchGaussians
    camera: Camera
    extras: dict[str, torch.Tensor]
    state: torch.Tensor | None

    @abstractmethod
    def backward(
        self, by_rgb: torch.Tensor, by_alpha: torch.Tensor | None, pose: tuple[int, ...] | None
    ) -> dict[str, torch.Tensor]:
        """Gradients by attribute, ``screen`` (N, 2) and, where it has a shape, ``pose``."""

    @abstractmethod
    def distances(self) -> torch.Tensor:
        """(N,) Euclidean, from the camera to the Gaussians."""

    def image(self, rgb: torch.Tensor, alpha: torch.Tensor, screen: torch.Tensor) -> Image:
        """What there is to see, of ``rgb`` and ``alpha`` with gradients."""
        extras = self.extras
        image = Image(rgb, alpha, extras["radii"], screen, None, extras.get("mean_depth"), extras.get("max_weights"))
        if "median_index" in extras:
            image.median_depth = picked(extras["median_index"], self.distances())
        return image


class _Rasterize(torch.autograd.Function):
    @staticmethod
    def forward(
        ctx: Context,
        drawn: tuple[RasterPass, torch.Tensor, torch.Tensor],
        pose: torch.Tensor | None,
        screen: torch.Tensor,
        *attributes: torch.Tensor,
    ) -> tuple[torch.Tensor, torch.Tensor]:
        ctx.drawing, rgb, alpha = drawn
        ctx.save_for_backward(*attributes)  # torch refuses tensors changed since; the drawing reads them
        ctx.pose_shape = pose.shape if pose is not None and pose.requires_grad else None
        ctx.like = rgb.new_empty(0), rgb.shape
        ctx.set_materialize_grads(False)  # of alpha: zeros of the size of the image
        return rgb, alpha

    @staticmethod
    def backward(ctx: Context, *grad_outputs: torch.Tensor | None) -> tuple[torch.Tensor | None, ...]:
        _ = ctx.saved_tensors
        by_rgb, by_alpha = grad_outputs
        if by_rgb is None:
            like, shape = ctx.like
            by_rgb = like.new_zeros(shape)
        gradients = ctx.drawing.backward(by_rgb, by_alpha, ctx.pose_shape)
        return None, gradients.get("pose"), gradients["screen"], *(gradients[name] for name in ATTRIBUTES)


def differentiable(
    drawn: tuple[RasterPass, torch.Tensor, torch.Tensor], gaussians: TorchGaussians, pose: torch.Tensor | None
) -> Image:
    """The image of a drawing, whose ``rgb`` and ``alpha`` bring gradients to the Gaussians and the ``pose``."""
    screen = drawn[1].new_zeros((len(gaussians), 2)).requires_grad_()
    apply: Callable[..., tuple[torch.Tensor, torch.Tensor]] = _Rasterize.apply
    rgb, alpha = apply(drawn, pose, screen, *gaussians.arrays.values())
    return drawn[0].image(rgb, alpha, screen)


def gains_of(camera: Camera, like: torch.Tensor) -> torch.Tensor:
    """(3,) the camera's exposure, of the type and where ``like`` is; nobody waits for it."""
    return launch.sent(torch.tensor(camera.exposure, dtype=like.dtype, device="cpu"), like.device)


def picked(index: torch.Tensor, distances: torch.Tensor) -> torch.Tensor:
    """(H, W) those (N,) of the Gaussians that ``index`` (H, W) names, NaN where it is -1."""
    return torch.cat([distances, distances.new_full((1,), float("nan"))])[index.long()]
