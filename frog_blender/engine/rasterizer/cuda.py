"""The CUDA rasterizer as a torch operation.

A tile's list holds the splats that reach it, nearest first. How many (tile, Gaussian) pairs an image has is only known
on the device: whoever draws waits for that number, or gives ``PairRoom``.
"""

from ctypes import Structure
from dataclasses import dataclass

import torch
from torch.nn.functional import pad

from ..capture.camera import Camera
from ..cuda import launch
from ..cuda.launch import blocks_for
from ..cuda.sources import kernel
from ..errors import FrogError
from ..gaussians import TorchGaussians
from ..native import structs
from ..native.options import RasterizeOptions
from . import Image
from .differentiable import RasterPass, differentiable

TILE = 16  # pixels a side; TILE in src/shared/types.h
MOMENTS = 9  # numbers in a gradient slot: SPLAT_GRADIENTS in src/shared/types.h
_BYTES_A_PAIR = 56  # of lists and gradient slots
_MOST_PAIRS = 2**31 - 2**10  # positions in a list, and a little beyond, have 32 bits


class PairRoom:
    """How many pairs a training's images may have, so that nobody waits to hear how many they do have.

    Attributes:
        pairs: so many at most; an image of more shows nothing, and the drawing's ``state`` says so. 0 before the first
            image, whose number is waited for.
    """

    def __init__(self) -> None:
        self.pairs = 0

    def grow(self, pairs: int, device: torch.device) -> None:
        """Makes room for an image of so many, and for the next larger ones; FrogError where there is none."""
        _refuse_too_many(pairs, device)
        self.pairs = min(max(2**16, 2 ** pairs.bit_length()), _most_pairs(device))


def _most_pairs(device: torch.device) -> int:
    """That half of the memory holds."""
    return min(_MOST_PAIRS, launch.launcher_for(device).memory // 2 // _BYTES_A_PAIR)


def _refuse_too_many(pairs: int, device: torch.device) -> None:
    memory, needed = launch.launcher_for(device).memory, pairs * _BYTES_A_PAIR
    if pairs > _most_pairs(device):
        lists = f"{pairs:,} overlaps of Gaussians and tiles need about {needed / 2**30:.1f} GiB"
        raise FrogError(
            f"An image is too large to draw: {lists} of GPU memory, more than half of its {memory / 2**30:.1f} GiB; "
            "expected a smaller image, or fewer or smaller Gaussians."
        )


@dataclass(frozen=True)
class CudaPass(RasterPass):
    """See RasterPass.

    Attributes:
        options: the kernels' struct.
        pose: (3, 4) on the device, instead of the camera's; or None.
        splats: (N, 16), ``Splat`` structs.
        counts: (N,) tiles that each splat reaches.
        first_slots, block_slots: (N,) and (blocks,) whose sum is where each Gaussian's slots begin.
        ranges: (tiles + 1,) where each tile's list begins.
        tile_splats, slots: (M,) the Gaussian and the slot of each pair, tile after tile.
    """

    options: Structure
    pose: torch.Tensor | None
    splats: torch.Tensor
    counts: torch.Tensor
    first_slots: torch.Tensor
    block_slots: torch.Tensor
    ranges: torch.Tensor
    tile_splats: torch.Tensor
    slots: torch.Tensor

    def backward(
        self, by_rgb: torch.Tensor, by_alpha: torch.Tensor | None, pose: tuple[int, ...] | None
    ) -> dict[str, torch.Tensor]:
        """See RasterPass."""
        attributes = self.gaussians.arrays
        count, device, blocks = len(self.splats), self.splats.device, len(self.block_slots)
        launcher = launch.launcher_for(device)
        slot_gradients = _floats(device, len(self.slots), MOMENTS)
        by_alpha = None if by_alpha is None else by_alpha.contiguous()
        launcher.launch(
            kernel("blend_backward"),
            len(self.ranges) - 1,
            *(self.splats, self.tile_splats, self.slots, self.ranges, self.options, _columns(self.options)),
            *(self.extras["transmittance"], self.extras["reached"], by_rgb.contiguous(), by_alpha, slot_gradients),
        )
        gradients = {name: _floats(device, *array.shape) for name, array in attributes.items()}
        gradients["screen"] = _floats(device, count, 2)
        pose_sums = None if pose is None else _floats(device, blocks, 12)
        launcher.launch(
            kernel("project_backward", SH_COUNT=attributes["sh"].shape[1], POSE=pose is not None),
            blocks,
            *(structs.gaussians_struct(self.gaussians), structs.camera_struct(self.camera), self.options, self.pose),
            *(self.counts, self.first_slots, self.block_slots, self.state, slot_gradients),
            *(structs.pointers(structs.Gradients, gradients), pose_sums),
        )
        if pose is not None and pose_sums is not None:
            rows = pose_sums.sum(0, dtype=torch.float64).to(torch.float32).reshape(3, 4)
            gradients["pose"] = rows if len(rows) == pose[0] else pad(rows, (0, 0, 0, 1))
        return gradients

    def distances(self) -> torch.Tensor:
        """See RasterPass."""
        means, matrix = self.gaussians.means.detach(), self.pose
        if matrix is None:
            rows = torch.from_numpy(self.camera.world_to_camera[:3])
            matrix = launch.sent(rows.to(means.dtype), means.device)
        local = (means[:, None, :] * matrix[:, :3]).sum(-1) + matrix[:, 3]  # a product may run in TF32
        distances: torch.Tensor = local.norm(dim=1)
        return distances


def draw(
    gaussians: TorchGaussians,
    camera: Camera,
    background: tuple[float, float, float],
    options: RasterizeOptions,
    *,
    is_differentiable: bool = True,
    pose: torch.Tensor | None = None,
    room: PairRoom | None = None,
) -> tuple[CudaPass, torch.Tensor, torch.Tensor]:
    """A drawing, its image (H, W, 3) and the image's alpha (H, W), without automatic differentiation.

    Args:
        gaussians: contiguous float32 tensors on one CUDA device.
        camera, background, options: see ``rasterizer.rasterize``.
        is_differentiable: whether ``RasterPass.backward`` will be called.
        pose: (3, 4) float32 on the device, instead of the camera's.
        room: for the pairs; without one the host waits for their number.
    """
    count, device = len(gaussians), gaussians.means.device
    launcher, blocks = launch.launcher_for(device), blocks_for(len(gaussians))
    region = options.region_of(camera)
    width, height = region[2:]
    columns = -(-width // TILE)
    tiles = columns * -(-height // TILE)
    drawn = structs.options_struct(options, background, region, gaussians.low_pass)
    if options.depth_limit is not None:
        limit = torch.tensor(options.depth_limit, device=device)
        drawn.depth_limit, drawn.arrays = limit.data_ptr(), (limit, gaussians.low_pass)
    outputs = _outputs(count, (height, width), device, options, is_differentiable)
    splats, (counts, first_slots) = _floats(device, count, structs.SPLAT_FLOATS), _ints(device, 2, count)
    block_slots, ranges, lengths = _ints(device, blocks), _ints(device, tiles + 1), _ints(device, tiles).zero_()
    state = torch.empty(2, device=device, dtype=torch.int64)
    launcher.launch(
        kernel("project", SH_COUNT=gaussians.sh.shape[1]),
        blocks,
        *(structs.gaussians_struct(gaussians), structs.camera_struct(camera), drawn, pose, columns, splats),
        *(counts, first_slots, block_slots, lengths, outputs["radii"], outputs.get("max_weights")),
    )
    most = room.pairs if room else 0
    launcher.launch(kernel("scan"), 1, tiles, lengths, ranges, blocks, block_slots, most or _MOST_PAIRS, state)
    if not most:
        most = int(state[0])
        _refuse_too_many(most, device)
        if room:
            room.grow(most, device)
    keys = torch.empty(most, device=device, dtype=torch.int64)
    owners, tile_splats, slots = _ints(device, 3, most)
    slots_at = counts, first_slots, block_slots, ranges, state
    launcher.launch(kernel("emit"), blocks, count, splats, *slots_at, width, columns, lengths, keys, owners)
    launcher.launch(kernel("sort"), tiles, ranges, owners, keys, tile_splats, slots)
    rgb, alpha = outputs.pop("rgb"), outputs.pop("alpha")
    optional = "transmittance", "reached", "median_index", "mean_depth", "max_weights"
    launcher.launch(
        kernel("blend", DEPTH=options.depth, WEIGHTS=options.weights),
        tiles,
        *(splats, tile_splats, ranges, drawn, columns, rgb, alpha, *(outputs.get(name) for name in optional)),
    )
    bins = splats, counts, first_slots, block_slots, ranges, tile_splats, slots
    return CudaPass(gaussians, camera, outputs, state, drawn, pose, *bins), rgb, alpha


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
    gaussians.check_tensors(gaussians.means.device)
    if pose is not None and pose.shape not in ((3, 4), (4, 4)):
        raise ValueError(f"pose: shape {tuple(pose.shape)}, expected (3, 4) or (4, 4)")
    rows = None if pose is None else pose.detach()[:3].to(gaussians.means).contiguous()
    plain = gaussians.mapped(torch.Tensor.detach)
    with_gradients = torch.is_grad_enabled()
    drawn = draw(plain, camera, background, options, is_differentiable=with_gradients, pose=rows)
    return differentiable(drawn, gaussians, pose)


def _outputs(
    count: int, size: tuple[int, int], device: torch.device, options: RasterizeOptions, is_differentiable: bool
) -> dict[str, torch.Tensor]:
    """What ``blend`` fills, by name; not set."""
    outputs = {"rgb": _floats(device, *size, 3), "alpha": _floats(device, *size), "radii": _floats(device, count)}
    if is_differentiable:
        outputs |= {"transmittance": _floats(device, *size), "reached": _ints(device, *size)}
    if options.depth:
        outputs |= {"median_index": _ints(device, *size), "mean_depth": _floats(device, *size)}
    if options.weights:
        outputs["max_weights"] = _floats(device, count)
    return outputs


def _columns(options: Structure) -> int:
    return -(-int(options.region[2]) // TILE)


def _floats(device: torch.device, *shape: int) -> torch.Tensor:
    """Uninitialised float32, whatever torch's default type is."""
    return torch.empty(shape, device=device, dtype=torch.float32)


def _ints(device: torch.device, *shape: int) -> torch.Tensor:
    """Uninitialised int32."""
    return torch.empty(shape, device=device, dtype=torch.int32)
