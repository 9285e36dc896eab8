"""The native rasterizer as a torch operation."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import torch

from ..capture.camera import Camera
from ..gaussians import GaussianArrays, TorchGaussians
from ..native import binding, structs
from ..native.options import RasterizeOptions
from ..notices import say
from . import Image
from .torch_types import Context, TensorKind

_CPU = torch.device("cpu")
# The library is given addresses alone: torch's defaults must not decide what lies there.
_FLOATS: TensorKind = {"dtype": torch.float32, "device": _CPU}
_INTEGERS: TensorKind = {"dtype": torch.int32, "device": _CPU}


@dataclass(frozen=True)
class RasterPass:
    """A drawing, kept for its backward pass, and its outputs besides the image. Without automatic differentiation.

    It does not hold the image: each would refer to the other, and neither would be freed.

    Attributes:
        gaussians, camera: what was drawn.
        size: (H, W).
        extras: outputs by name, see native.Frame.
        frame: the library's.
    """

    gaussians: TorchGaussians
    camera: Camera
    size: tuple[int, int]
    extras: dict[str, torch.Tensor]
    frame: binding.Frame

    def backward(
        self, by_rgb: torch.Tensor, by_alpha: torch.Tensor | None, pose: tuple[int, ...] | None
    ) -> dict[str, torch.Tensor]:
        """Gradients by attribute, ``screen`` (N, 2) and, where it has a shape, ``pose``."""
        gradients = {name: torch.empty(array.shape, **_FLOATS) for name, array in vars(self.gaussians).items()}
        gradients["screen"] = torch.empty((len(self.gaussians), 2), **_FLOATS)
        if pose is not None:
            gradients["pose"] = torch.zeros(pose, **_FLOATS)
        by_alpha = None if by_alpha is None else by_alpha.contiguous()
        self.frame.backward(by_rgb.contiguous(), by_alpha, gradients)
        return gradients

    def image(self, rgb: torch.Tensor, alpha: torch.Tensor, screen: torch.Tensor) -> Image:
        """What there is to see, of ``rgb`` and ``alpha`` with gradients."""
        extras = self.extras
        image = Image(rgb, alpha, extras["radii"], screen, max_weights=extras.get("max_weights"))
        if "median_index" in extras:
            image.mean_depth = extras["mean_depth"]
            means = self.gaussians.means.detach()
            image.median_depth = median_depth(extras["median_index"], means, self.camera)
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
    count, (_, _, width, height) = len(gaussians), options.region_of(camera)
    size = (height, width)
    rgb, alpha = torch.empty((*size, 3), **_FLOATS), torch.empty(size, **_FLOATS)
    extras = {"radii": torch.empty(count, **_FLOATS)}
    if options.depth:
        extras["median_index"] = torch.empty(size, **_INTEGERS)
        extras["mean_depth"] = torch.empty(size, **_FLOATS)
    if options.weights:
        extras["max_weights"] = torch.empty(count, **_FLOATS)
    outputs = {"rgb": rgb, "alpha": alpha, **extras}
    frame = binding.Frame(gaussians, camera, background, options, outputs, differentiable=differentiable)
    if not differentiable:  # a training's steps are many, and it tells its time itself
        say(frame.notice)
    return RasterPass(gaussians, camera, size, extras, frame), rgb, alpha


class _Rasterize(torch.autograd.Function):
    @staticmethod
    def forward(
        ctx: Context,
        draw_on: Callable[[TorchGaussians], tuple[RasterPass, torch.Tensor, torch.Tensor]],
        pose: torch.Tensor | None,
        screen: torch.Tensor,
        *attributes: torch.Tensor,
    ) -> tuple[torch.Tensor, torch.Tensor]:
        gaussians = GaussianArrays(*[tensor.contiguous() for tensor in attributes])
        ctx.drawing, rgb, alpha = draw_on(gaussians)
        ctx.save_for_backward(*vars(gaussians).values())  # torch refuses tensors changed since; the frame reads them
        ctx.pose_shape = None if pose is None else pose.shape
        ctx.set_materialize_grads(False)  # of alpha: zeros of the size of the image
        return rgb, alpha

    @staticmethod
    def backward(ctx: Context, *grad_outputs: torch.Tensor | None) -> tuple[torch.Tensor | None, ...]:
        _ = ctx.saved_tensors
        by_rgb, by_alpha = grad_outputs
        if by_rgb is None:
            by_rgb = torch.zeros((*ctx.drawing.size, 3), **_FLOATS)
        gradients = ctx.drawing.backward(by_rgb, by_alpha, ctx.pose_shape)
        return None, gradients.get("pose"), gradients["screen"], *(gradients[name] for name in structs.ATTRIBUTES)


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
    differentiable, drawings = torch.is_grad_enabled(), list[RasterPass]()

    def draw_on(arrays: TorchGaussians) -> tuple[RasterPass, torch.Tensor, torch.Tensor]:
        drawing, rgb, alpha = draw(arrays, camera, background, options, differentiable=differentiable)
        drawings.append(drawing)
        return drawing, rgb, alpha

    apply: Callable[..., tuple[torch.Tensor, torch.Tensor]] = _Rasterize.apply
    rgb, alpha = apply(draw_on, pose, screen, *vars(gaussians).values())
    return drawings.pop().image(rgb, alpha, screen)


def median_depth(index: torch.Tensor, means: torch.Tensor, camera: Camera) -> torch.Tensor:
    """(H, W) Euclidean distance to the Gaussians named by ``index`` (H, W), NaN where it is -1."""
    offsets = means - torch.as_tensor(camera.center, dtype=means.dtype, device=means.device)
    missing = means.new_full((1,), float("nan"))  # index -1 picks it
    return torch.cat([offsets.norm(dim=1), missing])[index.long()]
