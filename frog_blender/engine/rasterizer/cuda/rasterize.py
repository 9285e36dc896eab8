"""The CUDA rasterizer as a torch operation."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import torch
from torch.autograd.function import once_differentiable

from ...capture.camera import Camera
from ...gaussians import GaussianArrays, TorchGaussians
from ...native import structs
from ...native.options import RasterizeOptions
from .. import Image
from ..torch_types import Context
from . import launch
from .binning import TILE, Bins, bin_splats, blocks_for
from .sources import kernel

MOMENTS = 9  # numbers in a gradient slot: SPLAT_GRADIENTS in src/shared/types.h


@dataclass(frozen=True)
class _View:
    """What is drawn of which camera, and whether there may be a backward pass."""

    camera: structs.Camera
    options: structs.Options
    width: int
    height: int
    differentiable: bool

    @property
    def columns(self) -> int:
        return -(-self.width // TILE)

    @property
    def tiles(self) -> int:
        return self.columns * -(-self.height // TILE)


class _Rasterize(torch.autograd.Function):
    @staticmethod
    def forward(
        ctx: Context,
        view: _View,
        outputs: dict[str, torch.Tensor],
        pose: torch.Tensor | None,
        screen: torch.Tensor,
        *tensors: torch.Tensor,
    ) -> tuple[torch.Tensor, torch.Tensor]:
        attributes = [tensor.contiguous() for tensor in tensors]
        count, device = len(screen), screen.device
        launcher = launch.launcher_for(device)
        splats = _floats(device, count, structs.SPLAT_FLOATS)
        depths = _floats(device, count)
        tile_counts = torch.empty(count, device=device, dtype=torch.int32)
        launcher.launch(
            kernel("project", SH_COUNT=attributes[4].shape[1]),
            blocks_for(count),
            *(structs.gaussians_struct(GaussianArrays(*attributes)), view.camera, view.options, pose),
            *(splats, depths, tile_counts, outputs["radii"]),
        )
        bins = bin_splats(launcher, splats, depths, tile_counts, (view.width, view.height))
        size = (view.height, view.width)
        rgb, alpha = _floats(device, *size, 3), _floats(device, *size)
        extras = [outputs.get(name) for name in ("median_index", "mean_depth", "max_weights")]
        final_transmittance = _floats(device, *size) if view.differentiable else None
        reached = torch.empty(size, device=device, dtype=torch.int32) if view.differentiable else None
        launcher.launch(
            kernel("blend", DEPTH="median_index" in outputs, WEIGHTS="max_weights" in outputs),
            view.tiles,
            *(splats, bins.tile_splats, bins.ranges, view.options, view.columns),
            *(rgb, alpha, final_transmittance, reached, *extras),
        )
        ctx.view = view
        drawn = (bins.tile_splats, bins.slots, bins.ranges, bins.first_slots, splats, tile_counts)
        # Large buffers: torch frees them after the backward pass.
        ctx.save_for_backward(*attributes, pose, final_transmittance, reached, *drawn)
        return rgb, alpha

    @staticmethod
    @once_differentiable
    def backward(ctx: Context, *grad_outputs: torch.Tensor) -> tuple[torch.Tensor | None, ...]:
        view = ctx.view
        *attributes, pose, final_transmittance, reached, tile_splats, slots, ranges, first_slots, splats, counts = (
            ctx.saved_tensors
        )
        bins = Bins(tile_splats, slots, ranges, first_slots)
        by_rgb, by_alpha = (gradient.contiguous() for gradient in grad_outputs)
        count, device = len(splats), splats.device
        launcher = launch.launcher_for(device)
        slot_gradients = _floats(device, len(bins.slots), MOMENTS).zero_()
        launcher.launch(
            kernel("blend_backward"),
            view.tiles,
            *(splats, bins.tile_splats, bins.slots, bins.ranges, view.options, view.columns),
            *(final_transmittance, reached, by_rgb, by_alpha, slot_gradients),
        )
        gradients = [_floats(device, *tensor.shape) for tensor in attributes]
        by_screen = _floats(device, count, 2)
        written = [tensor.data_ptr() for tensor in (*gradients, by_screen)]
        blocks = blocks_for(count)
        with_pose = pose is not None and ctx.needs_input_grad[2]
        pose_sums = _floats(device, blocks, 12) if with_pose else None
        launcher.launch(
            kernel("project_backward", SH_COUNT=attributes[4].shape[1], POSE=with_pose),
            blocks,
            *(
                structs.gaussians_struct(GaussianArrays(*attributes)),
                view.camera,
                view.options,
                pose,
                counts,
                bins.first_slots,
            ),
            *(slot_gradients, structs.Gradients(*written, None), pose_sums),
        )
        by_pose = None
        if pose_sums is not None:
            by_pose = pose_sums.sum(0, dtype=torch.float64).to(torch.float32).reshape(3, 4)
        return (None, None, by_pose, by_screen, *gradients)


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
    means = gaussians.means
    count, device = len(gaussians), means.device
    gaussians.check_tensors(device)
    rows = _pose_rows(pose, device)
    view = _view(camera, background, options)
    size = (view.height, view.width)
    screen = _floats(device, count, 2).zero_().requires_grad_()
    outputs = {"radii": _floats(device, count)}
    if options.depth:
        outputs["median_index"] = torch.empty(size, device=device, dtype=torch.int32)
        outputs["mean_depth"] = _floats(device, *size)
    if options.weights:
        outputs["max_weights"] = _floats(device, count).zero_()
    attributes = [getattr(gaussians, name) for name in structs.ATTRIBUTES]
    apply: Callable[..., tuple[torch.Tensor, torch.Tensor]] = _Rasterize.apply
    rgb, alpha = apply(view, outputs, rows, screen, *attributes)
    image = Image(rgb, alpha, outputs["radii"], screen, max_weights=outputs.get("max_weights"))
    if options.depth:
        image.mean_depth = outputs["mean_depth"]
        matrix = torch.tensor(camera.world_to_camera[:3], device=device, dtype=torch.float32) if rows is None else rows
        image.median_depth = _median_depth(outputs["median_index"], means.detach(), matrix.detach())
    return image


def _pose_rows(pose: torch.Tensor | None, device: torch.device) -> torch.Tensor | None:
    """The upper three rows as the kernels read them; gradients flow through."""
    if pose is None:
        return None
    if pose.shape not in ((3, 4), (4, 4)):
        raise ValueError(f"pose: shape {tuple(pose.shape)}, expected (3, 4) or (4, 4)")
    return pose[:3].to(device=device, dtype=torch.float32).contiguous()


def _view(camera: Camera, background: tuple[float, float, float], options: RasterizeOptions) -> _View:
    region = options.region_of(camera)
    packed = structs.options_struct(options, background, region)
    return _View(structs.camera_struct(camera), packed, *region[2:], torch.is_grad_enabled())


def _floats(device: torch.device, *shape: int) -> torch.Tensor:
    """Uninitialised float32, whatever torch's default type is."""
    return torch.empty(shape, device=device, dtype=torch.float32)


def _median_depth(index: torch.Tensor, means: torch.Tensor, view: torch.Tensor) -> torch.Tensor:
    """(H, W) Euclidean distance to the Gaussians named by ``index`` (H, W), NaN where it is -1."""
    local = (means[:, None, :] * view[:, :3]).sum(-1) + view[:, 3]  # no matrix product: those may run in TF32
    missing = means.new_full((1,), float("nan"))  # index -1 picks it
    return torch.cat([local.norm(dim=1), missing])[index.long()]
