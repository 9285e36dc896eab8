"""The native rasterizer as a torch operation."""

from __future__ import annotations

from typing import Any

import torch

from ..capture.camera import Camera
from . import Image, native
from .arrays import GaussianArrays
from .options import RasterizeOptions


class _Rasterize(torch.autograd.Function):
    @staticmethod
    def forward(
        ctx: Any,
        means: torch.Tensor,
        quaternions: torch.Tensor,
        scales: torch.Tensor,
        opacities: torch.Tensor,
        sh: torch.Tensor,
        screen: torch.Tensor,
        camera: Camera,
        background: tuple[float, float, float],
        options: RasterizeOptions,
        extras: dict[str, torch.Tensor],
    ) -> tuple[torch.Tensor, torch.Tensor]:
        gaussians = GaussianArrays(*[t.contiguous() for t in (means, quaternions, scales, opacities, sh)])
        rgb = torch.empty((camera.height, camera.width, 3))
        alpha = torch.empty((camera.height, camera.width))
        ctx.frame = native.Frame(gaussians, camera, background, options, {"rgb": rgb, "alpha": alpha, **extras})
        ctx.save_for_backward(rgb, alpha)
        ctx.shapes = [t.shape for t in (means, quaternions, scales, opacities, sh, screen)]
        return rgb, alpha

    @staticmethod
    def backward(ctx: Any, *grad_outputs: torch.Tensor) -> tuple[torch.Tensor | None, ...]:
        gradients = [torch.empty(shape) for shape in ctx.shapes]
        names = ("means", "quaternions", "scales", "opacities", "sh", "screen")
        rgb, alpha = ctx.saved_tensors
        by_rgb, by_alpha = (gradient.contiguous() for gradient in grad_outputs)
        image = {"rgb": rgb, "alpha": alpha}
        ctx.frame.backward(image, by_rgb, by_alpha, dict(zip(names, gradients, strict=True)))
        return (*gradients, None, None, None, None)


def rasterize(
    gaussians: GaussianArrays, camera: Camera, background: tuple[float, float, float], options: RasterizeOptions
) -> Image:
    """As ``rasterizer.rasterize``, for float32 tensors on the CPU. The same bits for any number of threads."""
    _check(gaussians)
    count, size = len(gaussians), (camera.height, camera.width)
    screen = torch.zeros((count, 2), requires_grad=True)
    extras: dict[str, torch.Tensor] = {"radii": torch.empty(count)}
    if options.depth:
        extras["median_index"] = torch.empty(size, dtype=torch.int32)
        extras["mean_depth"] = torch.empty(size)
    if options.weights:
        extras["max_weights"] = torch.empty(count)
    rgb, alpha = _Rasterize.apply(
        gaussians.means,
        gaussians.quaternions,
        gaussians.scales,
        gaussians.opacities,
        gaussians.sh,
        screen,
        camera,
        background,
        options,
        extras,
    )
    image = Image(rgb, alpha, extras["radii"], screen, max_weights=extras.get("max_weights"))
    if options.depth:
        image.mean_depth = extras["mean_depth"]
        image.median_depth, image.median_z = median_depths(extras["median_index"], gaussians.means.detach(), camera)
    return image


def _check(gaussians: GaussianArrays) -> None:
    """ValueError naming a tensor that is not what the library, which only sees addresses, would read."""
    count, sh = len(gaussians), gaussians.sh
    shapes: dict[str, tuple[int, ...]] = {"means": (count, 3), "quaternions": (count, 4), "scales": (count, 3)}
    coefficients = sh.shape[1] if sh.ndim == 3 and sh.shape[1] in (1, 4, 9, 16) else 1
    shapes |= {"opacities": (count,), "sh": (count, coefficients, 3)}
    for name, shape in shapes.items():
        tensor = getattr(gaussians, name)
        if tensor.shape != shape or tensor.dtype != torch.float32 or tensor.device.type != "cpu":
            found = f"{tuple(tensor.shape)} {tensor.dtype} on {tensor.device}"
            raise ValueError(f"{name}: {found}, expected {shape} torch.float32 on cpu")


def median_depths(index: torch.Tensor, means: torch.Tensor, camera: Camera) -> tuple[torch.Tensor, torch.Tensor]:
    """Euclidean and planar depth (H, W) of the Gaussians named by ``index`` (H, W), NaN where it is -1."""
    center = torch.as_tensor(camera.center, dtype=means.dtype)
    forward = torch.as_tensor(camera.forward, dtype=means.dtype)
    offsets = means - center
    missing = torch.full((1,), float("nan"), dtype=means.dtype)
    distances = torch.cat([offsets.norm(dim=1), missing])  # index -1 picks the last
    planar = torch.cat([offsets @ forward, missing])
    return distances[index.long()], planar[index.long()]
