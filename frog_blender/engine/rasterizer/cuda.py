"""The CUDA rasterizer as a torch operation."""

from collections.abc import Callable
from ctypes import Structure

import torch
from torch.autograd.function import once_differentiable

from ..capture.camera import Camera
from ..cuda import launch
from ..cuda.sources import kernel
from ..gaussians import GaussianArrays, TorchGaussians
from ..native import structs
from ..native.options import RasterizeOptions
from . import Image
from .cpu import picked
from .cuda_binning import bin_splats, blocks_for, tiles_along
from .torch_types import Context

MOMENTS = 9  # numbers in a gradient slot: SPLAT_GRADIENTS in src/shared/types.h


class _Rasterize(torch.autograd.Function):
    @staticmethod
    def forward(
        ctx: Context,
        camera: Structure,
        options: Structure,
        outputs: dict[str, torch.Tensor],
        pose: torch.Tensor | None,
        screen: torch.Tensor,
        *attributes: torch.Tensor,
    ) -> tuple[torch.Tensor, torch.Tensor]:
        count, device = len(screen), screen.device
        launcher = launch.launcher_for(device)
        splats = _floats(device, count, structs.SPLAT_FLOATS)
        depths = _floats(device, count)
        tile_counts = torch.empty(count, device=device, dtype=torch.int32)
        launcher.launch(
            kernel("project", SH_COUNT=attributes[4].shape[1]),
            blocks_for(count),
            *(structs.gaussians_struct(GaussianArrays(*attributes)), camera, options, pose),
            *(splats, depths, tile_counts, outputs["radii"]),
        )
        bins = bin_splats(launcher, splats, depths, tile_counts, options.region[2:])
        tile_splats, _, ranges, _ = bins
        rgb, alpha = outputs["rgb"], outputs["alpha"]
        optional = "transmittance", "reached", "median_index", "mean_depth", "max_weights"
        extras = [outputs.get(name) for name in optional]
        launcher.launch(
            kernel("blend", DEPTH="median_index" in outputs, WEIGHTS="max_weights" in outputs),
            len(ranges) - 1,
            *(splats, tile_splats, ranges, options, tiles_along(options.region[2])),
            *(rgb, alpha, *extras),
        )
        ctx.camera, ctx.options = camera, options
        # Large buffers: torch frees them after the backward pass.
        ctx.save_for_backward(*attributes, pose, *extras[:2], *bins, splats, tile_counts)
        return rgb, alpha

    @staticmethod
    @once_differentiable
    def backward(ctx: Context, *grad_outputs: torch.Tensor) -> tuple[torch.Tensor | None, ...]:
        camera, options = ctx.camera, ctx.options
        *attributes, pose, final_transmittance, reached, tile_splats, slots, ranges, first_slots, splats, counts = (
            ctx.saved_tensors
        )
        by_rgb, by_alpha = (gradient.contiguous() for gradient in grad_outputs)
        count, device = len(splats), splats.device
        launcher = launch.launcher_for(device)
        slot_gradients = _floats(device, len(slots), MOMENTS).zero_()
        launcher.launch(
            kernel("blend_backward"),
            len(ranges) - 1,
            *(splats, tile_splats, slots, ranges, options, tiles_along(options.region[2])),
            *(final_transmittance, reached, by_rgb, by_alpha, slot_gradients),
        )
        gradients = [_floats(device, *tensor.shape) for tensor in attributes]
        by_screen = _floats(device, count, 2)
        written = [tensor.data_ptr() for tensor in (*gradients, by_screen)]
        blocks = blocks_for(count)
        with_pose = pose is not None and ctx.needs_input_grad[3]
        pose_sums = _floats(device, blocks, 12) if with_pose else None
        launcher.launch(
            kernel("project_backward", SH_COUNT=attributes[4].shape[1], POSE=with_pose),
            blocks,
            *(structs.gaussians_struct(GaussianArrays(*attributes)), camera, options, pose),
            *(counts, first_slots, slot_gradients, structs.Gradients(*written, None), pose_sums),
        )
        by_pose = None
        if pose_sums is not None:
            by_pose = pose_sums.sum(0, dtype=torch.float64).to(torch.float32).reshape(3, 4)
        return (None, None, None, by_pose, by_screen, *gradients)


def rasterize(
    gaussians: TorchGaussians,
    camera: Camera,
    background: tuple[float, float, float],
    options: RasterizeOptions,
    pose: torch.Tensor | None = None,
) -> Image:
    """As ``rasterizer.rasterize``, for float32 tensors on an NVIDIA GPU. The same bits in every run.

    Args:
        gaussians: float32 tensors on one CUDA device.
        camera: the view.
        background: three display-referred numbers.
        options: what to draw.
        pose: (4, 4) or (3, 4) world_to_camera instead of the camera's, differentiable.

    Raises:
        ValueError: a tensor has another shape, type or device.
        FrogError: no compiler or driver was found, or the image needs too much memory.
    """
    gaussians = gaussians.mapped(torch.Tensor.contiguous)
    means = gaussians.means
    count, device = len(gaussians), means.device
    gaussians.check_tensors(device)
    rows = _pose_rows(pose, device)
    left, top, width, height = options.region_of(camera)
    size = (height, width)
    screen = _floats(device, count, 2).zero_().requires_grad_()
    outputs = {"rgb": _floats(device, *size, 3), "alpha": _floats(device, *size), "radii": _floats(device, count)}
    if torch.is_grad_enabled():
        outputs["transmittance"] = _floats(device, *size)
        outputs["reached"] = torch.empty(size, device=device, dtype=torch.int32)
    if options.depth:
        outputs["median_index"] = torch.empty(size, device=device, dtype=torch.int32)
        outputs["mean_depth"] = _floats(device, *size)
    if options.weights:
        outputs["max_weights"] = _floats(device, count).zero_()
    apply: Callable[..., tuple[torch.Tensor, torch.Tensor]] = _Rasterize.apply
    drawn = structs.options_struct(options, background, (left, top, width, height), gaussians.low_pass)
    rgb, alpha = apply(structs.camera_struct(camera), drawn, outputs, rows, screen, *gaussians.arrays.values())
    extras = outputs.get("mean_depth"), outputs.get("max_weights")
    image = Image(rgb, alpha, outputs["radii"], screen, None, *extras)
    if options.depth:
        matrix = means.new_tensor(camera.world_to_camera[:3]) if rows is None else rows.detach()
        local = (means.detach()[:, None, :] * matrix[:, :3]).sum(-1) + matrix[:, 3]  # a product may run in TF32
        image.median_depth = picked(outputs["median_index"], local.norm(dim=1))
    return image


def _pose_rows(pose: torch.Tensor | None, device: torch.device) -> torch.Tensor | None:
    """The upper three rows as the kernels read them; gradients flow through."""
    if pose is None:
        return None
    if pose.shape not in ((3, 4), (4, 4)):
        raise ValueError(f"pose: shape {tuple(pose.shape)}, expected (3, 4) or (4, 4)")
    return pose[:3].to(device=device, dtype=torch.float32).contiguous()


def _floats(device: torch.device, *shape: int) -> torch.Tensor:
    """Uninitialised float32, whatever torch's default type is."""
    return torch.empty(shape, device=device, dtype=torch.float32)
