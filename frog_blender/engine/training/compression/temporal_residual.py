"""What changes over time where each Gaussian is: the error that its motion leaves, and the images themselves."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import torch

from ...capture.camera import Camera
from ...capture.capture import Capture
from ...gaussians import TorchGaussians
from ...rasterizer import Image, rasterize
from ...spherical_harmonics import SH_DC
from .sensitivity import SampledView
from .static_regions import TemporalVariance


def temporal_error_std(
    gaussians_at: Callable[[float], TorchGaussians],
    truth_of: Callable[[int], torch.Tensor],
    capture: Capture,
    shots: Sequence[Sequence[int]],
) -> torch.Tensor:
    """(N,) how much the error at each Gaussian changes over time: standard deviation of the mean difference (of the
    display range) of its pixels, weighted by blending weight, over the times of a camera; what nothing but motion
    explains. 0 where a Gaussian was not seen twice.

    Args:
        truth_of: (H, W, 3) image of a shot.
        shots: some shots of each of some cameras, at several times.
    """
    total_variance = views = torch.zeros((), device="cpu")
    for of_camera in shots:
        count = total = square = torch.zeros((), device="cpu")
        for index in of_camera:
            shot = capture.shots[index]
            gaussians = gaussians_at(capture.time_of(shot))
            image, colors = _splat_colors(gaussians, capture.cameras[shot.camera], capture.background)
            pixels, error = _splat_values(image, colors, (truth_of(index) - image.rgb.detach()).mean(2))
            seen = pixels >= 1.0
            error = torch.where(seen, error / pixels.clamp(min=1.0), 0.0)
            count, total, square = count + seen, total + error, square + error.square()
        n = count.clamp(min=2)
        of_all = torch.where(count >= 2, (square - total.square() / n).clamp(min=0), 0.0)
        total_variance, views = total_variance + of_all, views + (count - 1).clamp(min=0)
    return (total_variance / views.clamp(min=1)).sqrt()


def static_error(
    gaussians_at: Callable[[float], TorchGaussians],
    capture: Capture,
    views: Sequence[SampledView],
    variance: TemporalVariance,
) -> tuple[torch.Tensor, torch.Tensor]:
    """(N,) pixels that each Gaussian colours, in all views together, and the sum over them of ``variance``: the squared
    error of the images if it is static, and more where others pass before it."""
    pixels = lost = torch.zeros((), device="cpu")
    for view in views:
        camera = capture.cameras[view.camera]
        gaussians = gaussians_at(view.time)
        grey = replace(gaussians, sh=torch.zeros_like(gaussians.sh[:, :1]))  # no colour is clamped
        of_pixels = torch.from_numpy(variance.map_of(view.camera, camera.height, camera.width)).to(grey.means.device)
        found = _splat_values(*_splat_colors(grey, camera, capture.background), of_pixels)
        pixels, lost = pixels + found[0], lost + found[1]
    return pixels, lost


def _splat_colors(
    gaussians: TorchGaussians, camera: Camera, background: tuple[float, float, float]
) -> tuple[Image, torch.Tensor]:
    """An image, and the colours it was drawn with, which ask for gradients as nothing else does."""
    colors = gaussians.sh.detach().clone().requires_grad_()
    return rasterize(replace(gaussians, sh=colors), camera, background), colors


def _splat_values(image: Image, colors: torch.Tensor, values: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
    """(N,) pixels that each Gaussian colours, each by its blending weight, and the sum over them of ``values`` (H, W).

    A Gaussian's red is in the image's red by its blending weights: the backward pass sums what it is given in their
    proportion. It is given the values in red and ones in green, which counts the weights.
    """
    image.rgb.backward(torch.stack([values, torch.ones_like(values), torch.zeros_like(values)], dim=2))
    assert colors.grad is not None
    sums = colors.grad[:, 0] / SH_DC
    return sums[:, 1], sums[:, 0]
