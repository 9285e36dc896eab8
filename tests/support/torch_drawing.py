"""Drawing numpy Gaussians with torch, with gradients: what the rasterizer's tests share. Needs torch."""

import numpy as np
import torch

from frog_blender.engine.capture.camera import Camera
from frog_blender.engine.gaussians import ATTRIBUTES
from frog_blender.engine.rasterizer import GaussianArrays, Image, RasterizeOptions, rasterize

BACKGROUND = (0.3, 0.6, 0.1)
EVERYTHING = RasterizeOptions(depth=True, weights=True)


def tensors(gaussians: GaussianArrays, dtype: torch.dtype = torch.float32) -> GaussianArrays:
    """The same as leaves that collect gradients; values pass through float32, so that both precisions agree."""
    return gaussians.mapped(lambda array: torch.tensor(array, dtype=torch.float32).to(dtype).requires_grad_())


def image_weights(camera: Camera, seed: int = 5) -> tuple[torch.Tensor, torch.Tensor]:
    """Fixed random dL/drgb and dL/dalpha, float64."""
    generator = torch.Generator().manual_seed(seed)
    size = (camera.height, camera.width)
    return (
        torch.randn(*size, 3, generator=generator, dtype=torch.float64),
        torch.randn(*size, generator=generator, dtype=torch.float64),
    )


def cut(image: torch.Tensor, region: tuple[int, int, int, int]) -> torch.Tensor:
    """The region (left, top, width, height) of an image (H, W, ...)."""
    left, top, width, height = region
    return image[top : top + height, left : left + width]


def draw_with_gradients(
    gaussians: GaussianArrays,
    camera: Camera,
    backend: str,
    dtype: torch.dtype = torch.float32,
    options: RasterizeOptions = EVERYTHING,
    *,
    pose: np.ndarray | None = None,
    device: str = "cpu",
) -> tuple[Image, dict[str, np.ndarray]]:
    """The image, and gradients of a random linear loss on rgb and alpha by attribute, and by ``screen`` and ``pose``
    where there is one."""
    leaves = tensors(gaussians, dtype)
    values = leaves.mapped(lambda leaf: leaf.to(device))
    moving = None if pose is None else torch.tensor(pose, dtype=torch.float32).to(dtype).requires_grad_()
    there = None if moving is None else moving.to(device)
    image = rasterize(values, camera, BACKGROUND, options, pose=there, backend=backend)
    by_rgb, by_alpha = (cut(weights, options.region_of(camera)).to(device, dtype) for weights in image_weights(camera))
    ((image.rgb * by_rgb).sum() + (image.alpha * by_alpha).sum()).backward()
    gradients = {name: getattr(leaves, name).grad.numpy() for name in ATTRIBUTES}
    gradients["screen"] = image.screen.grad.cpu().numpy()
    if moving is not None:
        gradients["pose"] = moving.grad.numpy()
    return image, gradients


def native_image(gaussians: GaussianArrays, camera: Camera) -> dict[str, np.ndarray]:
    """Every output of the native library and every gradient, by name."""
    image, gradients = draw_with_gradients(gaussians, camera, "cpu")
    names = ("rgb", "alpha", "radii", "median_depth", "mean_depth", "max_weights")
    return {**{name: getattr(image, name).detach().numpy() for name in names}, **gradients}


def relative_error(found: np.ndarray, expected: np.ndarray) -> float:
    """L2 norm of the difference over the L2 norm of what is expected."""
    return float(np.linalg.norm(found.astype(np.float64) - expected) / max(np.linalg.norm(expected), 1e-30))
