"""The native rasterizer as a torch operation."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import torch

from ..capture.camera import Camera
from . import Image, native
from .arrays import GaussianArrays
from .options import RasterizeOptions

# The library is given addresses alone: torch's defaults, which anybody may set, must not decide what lies there.
_FLOATS: dict[str, Any] = {"dtype": torch.float32, "device": "cpu"}
_INTEGERS: dict[str, Any] = {"dtype": torch.int32, "device": "cpu"}


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
        pose: torch.Tensor | None,
        drawing: _Drawing,
    ) -> tuple[torch.Tensor, torch.Tensor]:
        gaussians = GaussianArrays(*[t.contiguous() for t in (means, quaternions, scales, opacities, sh)])
        rgb, alpha = torch.empty((*drawing.size, 3), **_FLOATS), torch.empty(drawing.size, **_FLOATS)
        ctx.frame = native.Frame(
            gaussians,
            drawing.camera,
            drawing.background,
            drawing.options,
            {"rgb": rgb, "alpha": alpha, **drawing.extras},
            drawing.depth_limit,
            drawing.differentiable,
        )
        ctx.save_for_backward(*vars(gaussians).values())  # torch refuses tensors changed since; the frame reads them
        ctx.size = drawing.size
        ctx.shapes = [t.shape for t in (means, quaternions, scales, opacities, sh, screen)]
        ctx.pose_shape = None if pose is None else pose.shape
        ctx.screen_absolute = drawing.screen_absolute
        ctx.set_materialize_grads(False)  # of alpha: zeros of the size of the picture
        return rgb, alpha

    @staticmethod
    def backward(ctx: Any, *grad_outputs: torch.Tensor | None) -> tuple[torch.Tensor | None, ...]:
        _ = ctx.saved_tensors
        gradients = [torch.empty(shape, **_FLOATS) for shape in ctx.shapes]
        pose = None if ctx.pose_shape is None else torch.zeros(ctx.pose_shape, **_FLOATS)
        names = ("means", "quaternions", "scales", "opacities", "sh", "screen")
        by_rgb, by_alpha = (None if gradient is None else gradient.contiguous() for gradient in grad_outputs)
        by_rgb = torch.zeros((*ctx.size, 3), **_FLOATS) if by_rgb is None else by_rgb
        wanted = dict(zip(names, gradients, strict=True)) | {"screen_absolute": ctx.screen_absolute, "pose": pose}
        ctx.frame.backward(by_rgb, by_alpha, wanted)
        return (*gradients, pose, None)


@dataclass
class _Drawing:
    """What ``_Rasterize`` needs besides tensors with gradients. ``extras`` are further outputs by name."""

    camera: Camera
    background: tuple[float, float, float]
    options: RasterizeOptions
    size: tuple[int, int]
    differentiable: bool
    depth_limit: torch.Tensor | None
    screen_absolute: torch.Tensor | None
    extras: dict[str, torch.Tensor]


def rasterize(
    gaussians: GaussianArrays,
    camera: Camera,
    background: tuple[float, float, float],
    options: RasterizeOptions,
    pose: torch.Tensor | None = None,
    depth_limit: torch.Tensor | None = None,
) -> Image:
    """As ``rasterizer.rasterize``, for float32 tensors on the CPU. The same bits for any number of threads."""
    gaussians.check_tensors(torch.device("cpu"))
    if pose is not None:
        camera = camera.with_pose(pose.detach().numpy())
    count = len(gaussians)
    _, _, width, height = options.region_of(camera)
    size = (height, width)
    screen = torch.zeros((count, 2), requires_grad=True, **_FLOATS)
    screen_absolute = torch.zeros((count, 2), **_FLOATS) if options.absolute else None
    extras = {"radii": torch.empty(count, **_FLOATS), "at_fault": torch.zeros(1, **_INTEGERS)}
    if options.depth:
        extras["median_index"] = torch.empty(size, **_INTEGERS)
        extras["mean_depth"] = torch.empty(size, **_FLOATS)
    if options.weights:
        extras["max_weights"] = torch.empty(count, **_FLOATS)
    if depth_limit is not None:
        depth_limit = depth_limit.detach().to("cpu", torch.float32).contiguous()
    drawing = _Drawing(camera, background, options, size, torch.is_grad_enabled(), depth_limit, screen_absolute, extras)
    rgb, alpha = _Rasterize.apply(
        gaussians.means,
        gaussians.quaternions,
        gaussians.scales,
        gaussians.opacities,
        gaussians.sh,
        screen,
        pose,
        drawing,
    )
    image = Image(rgb, alpha, extras["radii"], screen, screen_absolute, max_weights=extras.get("max_weights"))
    image.at_fault = int(extras["at_fault"])
    if options.depth:
        image.mean_depth = extras["mean_depth"]
        image.median_depth, image.median_z = median_depths(extras["median_index"], gaussians.means.detach(), camera)
    return image


def median_depths(index: torch.Tensor, means: torch.Tensor, camera: Camera) -> tuple[torch.Tensor, torch.Tensor]:
    """Euclidean and planar depth (H, W) of the Gaussians named by ``index`` (H, W), NaN where it is -1."""
    center = torch.as_tensor(camera.center, dtype=means.dtype)
    forward = torch.as_tensor(camera.forward, dtype=means.dtype)
    offsets = means - center
    missing = torch.full((1,), float("nan"), dtype=means.dtype)
    distances = torch.cat([offsets.norm(dim=1), missing])  # index -1 picks the last
    planar = torch.cat([offsets @ forward, missing])
    return distances[index.long()], planar[index.long()]
