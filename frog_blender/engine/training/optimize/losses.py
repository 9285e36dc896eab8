"""How far a drawing is from the image it should be: the loss and its gradient, and the errors by cells."""

from __future__ import annotations

import functools
from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from torch.nn import functional

from ...native.binding import CELL, l1_loss
from ...native.binding import ssim as native_ssim
from ...rasterizer import Image
from .device import image_on
from .mattes import Truth

_WINDOW, _SIGMA = 11, 1.5


@dataclass(frozen=True)
class PhotometricLoss:
    """How far a drawing is from its image; nothing of it has gradients.

    Attributes:
        loss: ().
        cell_errors: (rows, columns) mean squared difference in cells of CELL x CELL pixels; the border cuts the last.
        gradient: (H, W, 3) of the loss by the drawing.
        alpha_gradient: (H, W) of the loss by the drawing's alpha; None where that does not count.
    """

    loss: torch.Tensor
    cell_errors: torch.Tensor
    gradient: torch.Tensor
    alpha_gradient: torch.Tensor | None = None


def matte_loss(
    image: Image, truth: Truth, alpha_weight: float, *, dssim_weight: float, weight: float, square_weight: float = 0.0
) -> PhotometricLoss:
    """``photometric_loss`` of a drawing over the truth's background, plus ``weight`` ``alpha_weight`` mean |alpha -
    truth's|, without what is ignored: there drawing and truth are equal, to SSIM's windows too.

    Gradients outside the subject weigh as the truth says: all of what is empty would else outvote a small subject,
    and nothing at all would be drawn.
    """
    rgb, ignored = image.rgb.detach(), None
    if truth.ignored is not None and truth.ignored.any():
        ignored = torch.from_numpy(truth.ignored).to(rgb.device)
        rgb = rgb.masked_fill(ignored[..., None], 0)
    found = photometric_loss(rgb, truth.pixels, square_weight=square_weight, dssim_weight=dssim_weight, weight=weight)
    if ignored is not None:
        found.gradient[ignored] = 0
    if truth.alpha is None:
        return found
    alpha = image_on(rgb.device, np.ascontiguousarray(truth.alpha)).to(rgb.dtype)
    weights = torch.where(alpha > 0, 1.0, truth.empty_weight).to(rgb.dtype)
    found.gradient.mul_(weights[..., None])
    difference = image.alpha.detach() - alpha
    if ignored is not None:
        difference = difference.masked_fill(ignored, 0)
    share = weight * alpha_weight
    return PhotometricLoss(
        found.loss + share * difference.abs().mean(),
        found.cell_errors,
        found.gradient,
        difference.sign() * weights * (share / difference.numel()),
    )


def photometric_loss(
    image: torch.Tensor,
    pixels: NDArray[np.uint8],
    *,
    square_weight: float = 0.0,
    dssim_weight: float = 0.0,
    weight: float = 1.0,
) -> PhotometricLoss:
    """``weight`` (mean |image - truth| + ``square_weight`` mean (image - truth)^2 + ``dssim_weight`` (1 - SSIM) / 2).

    The squares are for what is missing: a place that is wrong by half of the range pulls no more than one that is
    wrong by a grey level in the first part.

    Float32 on the CPU goes through the native library: the first part in one pass over the image.

    Args:
        image: (H, W, 3) a drawing.
        pixels: (H, W, 3) uint8 what it should be; its rows may be part of a larger image's.
    """
    if image.dtype != torch.float32 or image.device.type != "cpu":
        return photometric_loss_reference(image, image_on(image.device, pixels), dssim_weight, weight, square_weight)
    image = image.detach().contiguous()
    gradient, cells = torch.empty_like(image), image.new_empty([-(-length // CELL) for length in pixels.shape[:2]])
    truth = torch.empty_like(image) if square_weight or dssim_weight else None
    loss = l1_loss(image, pixels, weight, gradient, cells, truth)
    if truth is not None and square_weight:
        difference = image - truth
        loss += square_weight * float(difference.square().mean())
        gradient.add_(difference, alpha=2 * weight * square_weight / difference.numel())
    if truth is not None and dssim_weight:
        slope = torch.empty_like(image)
        loss += dssim_weight * (1 - native_ssim(image, truth, slope)) / 2
        gradient.sub_(slope, alpha=weight * dssim_weight / 2)
    return PhotometricLoss(torch.tensor(weight * loss, device="cpu"), cells, gradient)


def photometric_loss_reference(
    image: torch.Tensor,
    truth: torch.Tensor,
    dssim_weight: float = 0.0,
    weight: float = 1.0,
    square_weight: float = 0.0,
) -> PhotometricLoss:
    """``photometric_loss`` in plain torch, on any device and in any floating-point type; ``truth`` in [0, 1]."""
    with torch.enable_grad():
        image = image.detach().requires_grad_()
        difference = image - truth
        error = difference.abs().mean()
        if square_weight:
            error = error + square_weight * difference.square().mean()
        loss = weight * (error + dssim_weight * (1 - ssim(image, truth)) / 2 if dssim_weight else error)
        (gradient,) = torch.autograd.grad(loss, image)
    square = difference.detach().square().permute(2, 0, 1)
    cells = functional.avg_pool2d(square, CELL, ceil_mode=True, count_include_pad=False).mean(0)
    return PhotometricLoss(loss.detach(), cells, gradient)


@functools.cache
def _kernel() -> torch.Tensor:
    offsets = torch.arange(_WINDOW, device="cpu") - _WINDOW // 2
    kernel = torch.exp(-offsets.square() / (2 * _SIGMA**2))
    return kernel / kernel.sum()


def ssim(image: torch.Tensor, truth: torch.Tensor) -> torch.Tensor:
    """Mean structural similarity of (H, W, 3) images in [0, 1], with the window of 3DGS (11 pixels, sigma 1.5)."""
    x, y = image.permute(2, 0, 1), truth.permute(2, 0, 1)
    moments = torch.cat([x, y, x * x, y * y, x * y])[None]
    channels = moments.shape[1]
    kernel = _kernel().to(moments, non_blocking=True)
    for shape, padding in (((1, _WINDOW), (0, _WINDOW // 2)), ((_WINDOW, 1), (_WINDOW // 2, 0))):
        weight = kernel.reshape(1, 1, *shape).expand(channels, 1, *shape)
        moments = functional.conv2d(moments, weight, padding=padding, groups=channels)
    mean_x, mean_y, square_x, square_y, product = moments[0].split(3)
    variance_x, variance_y = square_x - mean_x * mean_x, square_y - mean_y * mean_y
    covariance = product - mean_x * mean_y
    c1, c2 = 0.01**2, 0.03**2
    numerator = (2 * mean_x * mean_y + c1) * (2 * covariance + c2)
    denominator = (mean_x.square() + mean_y.square() + c1) * (variance_x + variance_y + c2)
    mean: torch.Tensor = (numerator / denominator).mean()
    return mean
