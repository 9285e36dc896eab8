"""Drawing Gaussians: one differentiable operation with three backends, ``cpu``, ``cuda`` and ``reference``.

``rasterize`` needs torch; importing this room does not.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Protocol

from ..capture.camera import NEUTRAL, Camera
from ..errors import FrogError
from ..gaussians import GaussianArrays, TorchGaussians
from ..native.options import RasterizeOptions
from ..registry import RASTERIZERS

if TYPE_CHECKING:
    import torch

__all__ = ["Backend", "GaussianArrays", "Image", "RasterizeOptions", "rasterize"]


@dataclass
class Image:
    """What one camera sees. ``rgb`` and ``alpha`` carry gradients; the rest does not.

    Attributes:
        rgb: (H, W, 3) display-referred, composited over the background.
        alpha: (H, W) coverage.
        radii: (N,) half the larger side of each splat's bounding box in pixels, 0 where culled.
        screen: (N, 2) zeros whose ``.grad`` becomes the gradient of the pixel positions (densification reads its norm).
        median_depth: (H, W) Euclidean distance to the centre of the Gaussian that takes transmittance through one half,
            NaN where none does (FRoG, section on canonical field sampling), or None.
        mean_depth: (H, W) planar depth averaged by blending weight, NaN where nothing was hit, or None.
        max_weights: (N,) each Gaussian's largest blending weight, or None.
    """

    rgb: torch.Tensor
    alpha: torch.Tensor
    radii: torch.Tensor
    screen: torch.Tensor
    median_depth: torch.Tensor | None = None
    mean_depth: torch.Tensor | None = None
    max_weights: torch.Tensor | None = None


class Backend(Protocol):
    """Draws Gaussians differentiably, without the camera's exposure; arguments as in ``rasterize``, checked."""

    def __call__(
        self,
        gaussians: TorchGaussians,
        camera: Camera,
        background: tuple[float, float, float],
        options: RasterizeOptions,
        pose: torch.Tensor | None = None,
    ) -> Image: ...


def rasterize(
    gaussians: TorchGaussians,
    camera: Camera,
    background: torch.Tensor | tuple[float, float, float] = (0.0, 0.0, 0.0),
    options: RasterizeOptions | None = None,
    *,
    pose: torch.Tensor | None = None,
    backend: Backend | str | None = None,
) -> Image:
    """Draws Gaussians (torch tensors) as ``camera`` sees and exposes them, differentiably in every Gaussian attribute.

    Args:
        gaussians: see GaussianArrays; scales and opacities activated.
        camera: the view.
        background: three display-referred numbers.
        options: RasterizeOptions.
        pose: (3, 4) or (4, 4) world_to_camera to use in place of the camera's, which receives gradients too.
        backend: what draws: a Backend, the name of one in ``registry.RASTERIZERS``, or None for the fastest that the
            tensors' device and type allow.
    """
    options = options or RasterizeOptions()
    red, green, blue = (float(value) for value in background)
    if backend is None:
        backend = default_backend(gaussians.means)
    elif isinstance(backend, str):
        backend = RASTERIZERS[backend]
    drawn = backend(gaussians, camera, (red, green, blue), options, pose)
    if not isinstance(drawn, Image):
        raise FrogError(f"The rasterizer {backend} gave {type(drawn).__name__}, expected an Image.")
    return exposed(drawn, camera)


def exposed(image: Image, camera: Camera) -> Image:
    """The image as bright as ``camera`` takes it."""
    if camera.exposure != NEUTRAL:
        from .differentiable import gains_of

        image.rgb = image.rgb * gains_of(camera, image.rgb)
    return image


def default_backend(means: torch.Tensor) -> Backend:
    """The fastest for the device and type of these tensors; the reference where there is no other."""
    if means.dtype.itemsize == 4 and means.device.type in ("cpu", "cuda"):
        return RASTERIZERS[means.device.type]
    return RASTERIZERS["reference"]
