"""Frames for those who have numpy arrays, drawn by the CUDA rasterizer."""

import functools
from collections.abc import Mapping

import numpy as np
import torch

from ..arrays import Array
from ..capture.camera import Camera
from ..errors import FrogError
from ..gaussians import GaussianArrays, NumpyGaussians
from ..native.binding import Frame
from ..native.options import RasterizeOptions
from .cuda import draw


def fill(
    device: torch.device,
    gaussians: NumpyGaussians,
    camera: Camera,
    background: tuple[float, float, float],
    options: RasterizeOptions,
    image: Mapping[str, Array],
) -> None:
    """Draws into the arrays of ``image`` on a GPU; arguments as of ``native.binding.Frame``.

    FrogError or a RuntimeError of torch's where the GPU refuses, or has not enough memory.
    """
    with torch.inference_mode(), torch.cuda.stream(_stream(device)):
        # Copied once, straight to the device, without a word about arrays that are read-only.
        there = gaussians.mapped(lambda array: torch.tensor(array, device=device))
        drawing, rgb, alpha = draw(there, camera, background, options, is_differentiable=False)
        drawn = {**drawing.extras, "rgb": rgb, "alpha": alpha}
        for name, array in image.items():
            torch.from_numpy(array).copy_(drawn[name])


@functools.cache
def _stream(device: torch.device) -> torch.cuda.Stream | None:
    """Frames do not wait for the steps of a training that are queued on the same GPU."""
    return torch.cuda.Stream(device, priority=-1) if device.type == "cuda" else None


def try_frames(device: torch.device) -> None:
    """Compiles and runs what frames need; FrogError where they are not what the native library draws."""
    random, options = np.random.default_rng(0), RasterizeOptions(depth=True)
    away = np.eye(4)
    away[:3, 3] = -0.5, -0.5, 1
    camera = Camera("trial", 48, 32, np.array([[40.0, 0, 24], [0, 40, 16], [0, 0, 1]]), away)
    for coefficients in (1, 4, 16):
        shapes = (64, 3), (64, 4), (64, 3), (64,), (64, coefficients, 3)
        gaussians = GaussianArrays(*(random.uniform(0, 0.3, shape) for shape in shapes)).checked()
        gaussians.means *= 3
        found, expected = (options.new_image(camera, 64) for _ in range(2))
        fill(device, gaussians, camera, (0, 0, 0), options, found)
        Frame(gaussians, camera, (0, 0, 0), options, expected)
        for name, array in expected.items():
            if np.isclose(found[name], array, rtol=1e-3, atol=1e-3, equal_nan=True).mean() < 0.99:
                raise FrogError(f"The CUDA rasterizer's {name} is not what the native library draws.")
