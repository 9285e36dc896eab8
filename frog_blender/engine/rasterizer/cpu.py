"""The native rasterizer as a torch operation."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import torch

from ..capture.camera import Camera
from ..gaussians import ATTRIBUTES, TorchGaussians
from ..native import binding
from ..native.options import RasterizeOptions
from ..notices import say
from . import Image
from .torch_types import Context, TensorKind

_CPU = torch.device("cpu")
# The library is given addresses alone: torch's defaults must not decide what lies there.
_FLOATS: TensorKind = {"dtype": torch.float32, "device": _CPU}


@dataclass(frozen=True)
class RasterPass:
    """A drawing, kept for its backward pass, and its outputs besides the image. Without automatic differentiation.

    It does not hold the image: each would refer to the other, and neither would be freed.

    Attributes:
        gaussians, camera: what was drawn.
        extras: outputs by name, see native.Frame.
        frame: the library's.
    """

    gaussians: TorchGaussians
    camera: Camera
    extras: dict[str, torch.Tensor]
    frame: binding.Frame

    def backward(
        self, by_rgb: torch.Tensor, by_alpha: torch.Tensor | None, pose: tuple[int, ...] | None
    ) -> dict[str, torch.Tensor]:
        """Gradients by attribute, ``screen`` (N, 2) and, where it has a shape, ``pose``."""
        gradients = {name: torch.empty(array.shape, **_FLOATS) for name, array in self.gaussians.arrays.items()}
        gradients["screen"] = torch.empty((len(self.gaussians), 2), **_FLOATS)
        if pose is not None:
            gradients["pose"] = torch.zeros(pose, **_FLOATS)
        by_alpha = None if by_alpha is None else by_alpha.contiguous()
        self.frame.backward(by_rgb.contiguous(), by_alpha, gradients)
        return gradients

    def image(self, rgb: torch.Tensor, alpha: torch.Tensor, screen: torch.Tensor) -> Image:
        """What there is to see, of ``rgb`` and ``alpha`` with gradients."""
        extras = self.extras
        image = Image(rgb, alpha, extras["radii"], screen, None, extras.get("mean_depth"), extras.get("max_weights"))
        if "median_index" in extras:
            distances = distances_from(self.camera, self.gaussians.means.detach())
            image.median_depth = picked(extras["median_index"], distances)
        return image


def draw(
    gaussians: TorchGaussians,
    camera: Camera,
    background: tuple[float, float, float],
    options: RasterizeOptions,
    *,
    differentiable: bool = True,
) -> tuple[RasterPass, torch.Tensor, torch.Tensor]:
    """A drawing, its image (H, W, 3) and the image's alpha (H, W), without automatic differentiation.

    Args:
        gaussians: contiguous float32 tensors on the CPU.
        camera, background, options: see ``rasterizer.rasterize``.
        differentiable: whether ``RasterPass.backward`` will be called.
    """
    arrays = options.new_image(camera, len(gaussians)) | {"radii": np.empty(len(gaussians), np.float32)}
    frame = binding.Frame(gaussians, camera, background, options, arrays, differentiable=differentiable)
    if not differentiable:  # a training's steps are many, and it tells its time itself
        say(frame.notice)
    image = {name: torch.from_numpy(array) for name, array in arrays.items()}
    rgb, alpha = image.pop("rgb"), image.pop("alpha")
    return RasterPass(gaussians, camera, image, frame), rgb, alpha


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
        ctx.save_for_backward(*attributes)  # torch refuses tensors changed since; the frame reads them
        ctx.pose_shape = None if pose is None else pose.shape
        ctx.size = alpha.shape
        ctx.set_materialize_grads(False)  # of alpha: zeros of the size of the image
        return rgb, alpha

    @staticmethod
    def backward(ctx: Context, *grad_outputs: torch.Tensor | None) -> tuple[torch.Tensor | None, ...]:
        _ = ctx.saved_tensors
        by_rgb, by_alpha = grad_outputs
        if by_rgb is None:
            by_rgb = torch.zeros((*ctx.size, 3), **_FLOATS)
        gradients = ctx.drawing.backward(by_rgb, by_alpha, ctx.pose_shape)
        return None, gradients.get("pose"), gradients["screen"], *(gradients[name] for name in ATTRIBUTES)


def rasterize(
    gaussians: TorchGaussians,
    camera: Camera,
    background: tuple[float, float, float],
    options: RasterizeOptions,
    pose: torch.Tensor | None = None,
) -> Image:
    """As ``rasterizer.rasterize``, for float32 tensors on the CPU. The same bits for any number of threads."""
    gaussians.check_tensors(_CPU)
    if pose is not None:
        camera = camera.with_pose(pose.detach().numpy())
    screen = torch.zeros((len(gaussians), 2), requires_grad=True, **_FLOATS)
    gaussians = gaussians.mapped(torch.Tensor.contiguous)
    plain = gaussians.mapped(torch.Tensor.detach)
    drawn = draw(plain, camera, background, options, differentiable=torch.is_grad_enabled())
    apply: Callable[..., tuple[torch.Tensor, torch.Tensor]] = _Rasterize.apply
    rgb, alpha = apply(drawn, pose, screen, *gaussians.arrays.values())
    return drawn[0].image(rgb, alpha, screen)


def distances_from(camera: Camera, means: torch.Tensor) -> torch.Tensor:
    """(N,) Euclidean."""
    offsets = means - torch.as_tensor(camera.center, dtype=means.dtype, device=means.device)
    distances: torch.Tensor = offsets.norm(dim=1)
    return distances


def picked(index: torch.Tensor, distances: torch.Tensor) -> torch.Tensor:
    """(H, W) those (N,) of the Gaussians that ``index`` (H, W) names, NaN where it is -1."""
    return torch.cat([distances, distances.new_full((1,), float("nan"))])[index.long()]
