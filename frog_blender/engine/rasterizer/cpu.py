"""The native rasterizer as a torch operation."""

from dataclasses import dataclass

import numpy as np
import torch

from ..capture.camera import Camera
from ..gaussians import TorchGaussians
from ..native import binding
from ..native.options import RasterizeOptions
from ..notices import say
from . import Image
from .differentiable import RasterPass, differentiable
from .torch_types import TensorKind

_CPU = torch.device("cpu")
# The library is given addresses alone: torch's defaults must not decide what lies there.
_FLOATS: TensorKind = {"dtype": torch.float32, "device": _CPU}


@dataclass(frozen=True)
class NativePass(RasterPass):
    """See RasterPass.

    Attributes:
        frame: the library's.
    """

    frame: binding.Frame

    def backward(
        self, by_rgb: torch.Tensor, by_alpha: torch.Tensor | None, pose: tuple[int, ...] | None
    ) -> dict[str, torch.Tensor]:
        """See RasterPass."""
        gradients = {name: torch.empty(array.shape, **_FLOATS) for name, array in self.gaussians.arrays.items()}
        gradients["screen"] = torch.empty((len(self.gaussians), 2), **_FLOATS)
        if pose is not None:
            gradients["pose"] = torch.zeros(pose, **_FLOATS)
        by_alpha = None if by_alpha is None else by_alpha.contiguous()
        self.frame.backward(by_rgb.contiguous(), by_alpha, gradients)
        return gradients

    def distances(self) -> torch.Tensor:
        """See RasterPass."""
        return distances_from(self.camera, self.gaussians.means.detach())


def draw(
    gaussians: TorchGaussians,
    camera: Camera,
    background: tuple[float, float, float],
    options: RasterizeOptions,
    *,
    is_differentiable: bool = True,
) -> tuple[NativePass, torch.Tensor, torch.Tensor]:
    """A drawing, its image (H, W, 3) and the image's alpha (H, W), without automatic differentiation.

    Args:
        gaussians: contiguous float32 tensors on the CPU.
        camera, background, options: see ``rasterizer.rasterize``.
        is_differentiable: whether ``RasterPass.backward`` will be called.
    """
    arrays = options.new_image(camera, len(gaussians)) | {"radii": np.empty(len(gaussians), np.float32)}
    frame = binding.Frame(gaussians, camera, background, options, arrays, differentiable=is_differentiable)
    if not is_differentiable:  # a training's steps are many, and it tells its time itself
        say(frame.notice)
    image = {name: torch.from_numpy(array) for name, array in arrays.items()}
    rgb, alpha = image.pop("rgb"), image.pop("alpha")
    return NativePass(gaussians, camera, image, None, frame), rgb, alpha


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
    gaussians = gaussians.mapped(torch.Tensor.contiguous)
    plain = gaussians.mapped(torch.Tensor.detach)
    drawn = draw(plain, camera, background, options, is_differentiable=torch.is_grad_enabled())
    return differentiable(drawn, gaussians, pose)


def distances_from(camera: Camera, means: torch.Tensor) -> torch.Tensor:
    """(N,) Euclidean."""
    offsets = means - torch.as_tensor(camera.center, dtype=means.dtype, device=means.device)
    distances: torch.Tensor = offsets.norm(dim=1)
    return distances
