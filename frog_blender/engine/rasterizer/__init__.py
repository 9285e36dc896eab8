"""How Gaussians are drawn: one differentiable operation, several implementations of the same page of mathematics.

``rasterize`` needs torch; ``native`` and ``arrays`` do not.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from .arrays import GaussianArrays
from .options import RasterizeOptions

if TYPE_CHECKING:
    import torch

    from ..capture.camera import Camera

__all__ = ["GaussianArrays", "Image", "RasterizeOptions", "rasterize"]


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
        median_z: (H, W) planar depth of the same centre, or None.
        mean_depth: (H, W) planar depth averaged by blending weight, NaN where nothing was hit, or None.
        max_weights: (N,) each Gaussian's largest blending weight, or None.
    """

    rgb: torch.Tensor
    alpha: torch.Tensor
    radii: torch.Tensor
    screen: torch.Tensor
    median_depth: torch.Tensor | None = None
    median_z: torch.Tensor | None = None
    mean_depth: torch.Tensor | None = None
    max_weights: torch.Tensor | None = None


def rasterize(
    gaussians: GaussianArrays,
    camera: Camera,
    background: torch.Tensor | tuple[float, float, float] = (0.0, 0.0, 0.0),
    options: RasterizeOptions | None = None,
    *,
    implementation: str = "auto",
) -> Image:
    """Draws Gaussians (torch tensors) as ``camera`` sees them, differentiably in every Gaussian attribute.

    Args:
        gaussians: see GaussianArrays; scales and opacities activated.
        camera: the view.
        background: three display-referred numbers.
        options: RasterizeOptions.
        implementation: "auto" (native for float32 on the CPU, else the reference), "cpu" or "reference".
    """
    from . import cpu, reference

    options = options or RasterizeOptions()
    red, green, blue = (float(value) for value in background)
    if implementation == "auto":
        native = gaussians.means.device.type == "cpu" and gaussians.means.dtype.itemsize == 4
        implementation = "cpu" if native else "reference"
    draw = {"cpu": cpu.rasterize, "reference": reference.rasterize}[implementation]
    return draw(gaussians, camera, (red, green, blue), options)
