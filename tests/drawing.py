"""Drawing numpy Gaussians with torch, with gradients: what the rasterizer's tests share. Needs torch."""

from __future__ import annotations

import numpy as np
import torch
from helpers import ATTRIBUTES

from frog_blender.engine.capture.camera import Camera
from frog_blender.engine.rasterizer import GaussianArrays, Image, RasterizeOptions, rasterize

BACKGROUND = (0.3, 0.6, 0.1)
EVERYTHING = RasterizeOptions(depth=True, weights=True)


def tensors(gaussians: GaussianArrays, dtype: torch.dtype = torch.float32) -> GaussianArrays:
    """The same as leaves that collect gradients; values always pass through float32, so that both precisions agree."""
    return GaussianArrays(
        *[torch.tensor(getattr(gaussians, name), dtype=torch.float32).to(dtype).requires_grad_() for name in ATTRIBUTES]
    )


def image_weights(camera: Camera, seed: int = 5) -> tuple[torch.Tensor, torch.Tensor]:
    """Fixed random dL/drgb and dL/dalpha, float64."""
    generator = torch.Generator().manual_seed(seed)
    size = (camera.height, camera.width)
    return (
        torch.randn(*size, 3, generator=generator, dtype=torch.float64),
        torch.randn(*size, generator=generator, dtype=torch.float64),
    )


def draw_with_gradients(
    gaussians: GaussianArrays,
    camera: Camera,
    implementation: str,
    dtype: torch.dtype = torch.float32,
    options: RasterizeOptions = EVERYTHING,
) -> tuple[Image, dict[str, np.ndarray]]:
    """The picture, and gradients by attribute (and ``screen``) of a random linear loss on rgb and alpha."""
    leaves = tensors(gaussians, dtype)
    image = rasterize(leaves, camera, BACKGROUND, options, implementation=implementation)
    by_rgb, by_alpha = image_weights(camera)
    ((image.rgb * by_rgb.to(dtype)).sum() + (image.alpha * by_alpha.to(dtype)).sum()).backward()
    gradients = {name: getattr(leaves, name).grad.numpy() for name in ATTRIBUTES}
    return image, {**gradients, "screen": image.screen.grad.numpy()}


def native_picture(gaussians: GaussianArrays, camera: Camera) -> dict[str, np.ndarray]:
    """Every output of the native library and every gradient, by name."""
    image, gradients = draw_with_gradients(gaussians, camera, "cpu")
    names = ("rgb", "alpha", "radii", "median_depth", "median_z", "mean_depth", "max_weights")
    return {**{name: getattr(image, name).detach().numpy() for name in names}, **gradients}


def relative_error(found: np.ndarray, expected: np.ndarray) -> float:
    """L2 norm of the difference over the L2 norm of what is expected."""
    return float(np.linalg.norm(found.astype(np.float64) - expected) / np.linalg.norm(expected))
