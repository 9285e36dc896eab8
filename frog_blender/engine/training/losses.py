"""Image losses and the embedding smoothness (FRoG, section on optimisation)."""

from __future__ import annotations

import functools
from typing import Any

import torch
from torch.nn import functional

from ..rasterizer.native import similarity

_WINDOW, _SIGMA = 11, 1.5


@functools.cache
def _kernel() -> torch.Tensor:
    offsets = torch.arange(_WINDOW, device="cpu") - _WINDOW // 2
    kernel = torch.exp(-offsets.square() / (2 * _SIGMA**2))
    return kernel / kernel.sum()


class _AbsoluteError(torch.autograd.Function):
    """Written out: automatic differentiation takes twice as many passes over the picture."""

    @staticmethod
    def forward(ctx: Any, difference: torch.Tensor) -> torch.Tensor:
        ctx.save_for_backward(difference)
        return difference.abs().mean()

    @staticmethod
    def backward(ctx: Any, *by: torch.Tensor) -> torch.Tensor:
        (difference,) = ctx.saved_tensors
        return difference.sign().mul_(by[0] / difference.numel())


def absolute_error(difference: torch.Tensor) -> torch.Tensor:
    """Mean of |difference|, in any shape."""
    return _AbsoluteError.apply(difference)


class _Similarity(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, image: torch.Tensor, truth: torch.Tensor) -> torch.Tensor:
        gradient = torch.empty_like(image)
        value = similarity(image, truth, gradient)
        ctx.save_for_backward(gradient)
        return torch.tensor(value, device=image.device)

    @staticmethod
    def backward(ctx: Any, *by: torch.Tensor) -> tuple[torch.Tensor | None, ...]:
        (gradient,) = ctx.saved_tensors
        return by[0] * gradient, None


def ssim(image: torch.Tensor, truth: torch.Tensor) -> torch.Tensor:
    """Mean structural similarity of (H, W, 3) pictures in [0, 1], with the window of 3DGS (11 pixels, sigma 1.5).

    Float32 on the CPU goes through the native library, which takes a tenth of the time. ``truth`` gets no gradient.
    """
    if image.dtype == torch.float32 and image.device.type == "cpu":
        return _Similarity.apply(image.contiguous(), truth.contiguous())
    return ssim_plainly(image, truth)


def ssim_plainly(image: torch.Tensor, truth: torch.Tensor) -> torch.Tensor:
    """``ssim`` in plain torch, on any device and in any floating-point type."""
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
    return (numerator / ((mean_x.square() + mean_y.square() + c1) * (variance_x + variance_y + c2))).mean()


@torch.no_grad()
def add_embedding_smoothness(
    embeddings: torch.Tensor, anchors: torch.Tensor, neighbours: torch.Tensor, weights: torch.Tensor, weight: float
) -> None:
    """Adds to ``embeddings.grad`` the gradient of the mean over (i, j) of w_ij |e_i - e_j| (the paper's L_emb-reg).

    Written out, because only the few drawn rows have a gradient; automatic differentiation would make one of all rows
    for each of the two look-ups.

    Args:
        embeddings: (N, E) with a gradient.
        anchors: (A,) indices i, drawn this time.
        neighbours: (A, k) indices j.
        weights: (A, k), see ``neighbour_weights``.
        weight: of the loss.
    """
    assert embeddings.grad is not None
    differences = embeddings[anchors][:, None] - embeddings[neighbours]
    lengths = (differences.square().sum(-1) + 1e-12).sqrt()
    gradient = differences * (weight / weights.numel() * weights / lengths)[..., None]
    embeddings.grad.index_add_(0, anchors, gradient.sum(1))
    embeddings.grad.index_add_(0, neighbours.flatten(), gradient.flatten(0, 1), alpha=-1)


def neighbour_weights(distances: torch.Tensor, falloff: float) -> torch.Tensor:
    """exp(-falloff d^2) with d in units of the median nearest-neighbour distance, which makes it free of scene units.

    Args:
        distances: (A, k) ascending along k, world units.
    """
    unit = distances[:, 0].median().clamp(min=1e-12)
    return torch.exp(-falloff * (distances / unit).square())
