"""How far a drawing is from the image it should be: the loss and its gradient, and the errors by cells."""

import functools
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import torch
from torch.nn import functional

from ...cuda import launch
from ...cuda.loss import compare, read
from ...errors import FrogError
from ...native.binding import CELL, l1_loss
from ...native.binding import ssim as native_ssim
from ...rasterizer import Image
from ...registry import LOSSES
from .mattes import Truth
from .transfers import OnItsWay

_WINDOW, _SIGMA = 11, 1.5


@dataclass(frozen=True)
class Figures:
    """What there is to tell of a loss, on the CPU.

    Attributes:
        terms: what the loss is the sum of, by name.
        cell_errors: (rows, columns) mean squared difference in cells of CELL x CELL pixels; the border cuts the last.
        state: of the drawing, see ``RasterPass``.
    """

    terms: dict[str, float]
    cell_errors: torch.Tensor
    state: Sequence[int] = (0, 0)

    @property
    def loss(self) -> float:
        return sum(self.terms.values())


@dataclass(frozen=True)
class PhotometricLoss:
    """How far a drawing is from its image; nothing of it has gradients.

    Attributes:
        gradient: (H, W, 3) of the loss by the drawing.
        figures: on a GPU asked for already; a call waits until they are there.
        alpha_gradient: (H, W) of the loss by the drawing's alpha; None where that does not count.
    """

    gradient: torch.Tensor
    figures: Callable[[], Figures]
    alpha_gradient: torch.Tensor | None = None


def matte_loss(
    image: Image,
    truth: Truth,
    alpha_weight: float,
    terms: Mapping[str, float],
    weight: float,
    state: torch.Tensor | None = None,
) -> PhotometricLoss:
    """``photometric_loss`` of a drawing over the truth's background, plus ``weight`` ``alpha_weight`` mean |alpha -
    truth's|, without what is ignored: there drawing and truth are equal, to SSIM's windows too.

    Gradients outside the subject weigh as the truth says: all of what is empty would else outvote a small subject,
    and nothing at all would be drawn.

    Args:
        state: on a GPU, of the drawing, see ``RasterPass``; the figures bring it along.
    """
    rgb, ignored = image.rgb.detach(), truth.ignored
    if rgb.dtype == torch.float32 and launch.on_gpu(rgb):
        return _by_kernels(image, truth, alpha_weight, terms, weight, state)
    if ignored is not None:
        rgb = rgb.masked_fill(ignored[..., None], 0)
    photometric = photometric_loss(rgb, truth.pixels, terms, weight)
    _weigh(photometric.gradient, truth)
    if truth.alpha is None:
        return photometric
    difference = image.alpha.detach() - truth.alpha.to(rgb.dtype) / 255
    if ignored is not None:
        difference = difference.masked_fill(ignored, 0)
    share = weight * alpha_weight
    added, by_alpha = OnItsWay(share * difference.abs().mean()), difference.sign() * (share / difference.numel())
    _weigh(by_alpha[..., None], truth)

    def figures() -> Figures:
        known = photometric.figures()
        return replace(known, terms={**known.terms, "alpha": float(added.here())})

    return PhotometricLoss(photometric.gradient, figures, by_alpha)


def _weigh(gradient: torch.Tensor, truth: Truth) -> None:
    """Weighs (H, W, ...) gradients by what pixels count."""
    if truth.ignored is not None:
        gradient.masked_fill_(truth.ignored[..., None], 0)
    if truth.alpha is not None:
        gradient.mul_(torch.where(truth.alpha > 0, 1.0, truth.empty_weight).to(gradient.dtype)[..., None])


def photometric_loss(
    image: torch.Tensor, pixels: torch.Tensor, terms: Mapping[str, float], weight: float
) -> PhotometricLoss:
    """``weight`` times the sum of ``l1`` and of the ``terms``, each with a weight of its own.

    Float32 on the CPU goes through the native library: ``l1`` in one pass over the image, which ``square`` and
    ``dssim`` add to. Other terms are derived by torch.

    Args:
        image: (H, W, 3) a drawing.
        pixels: (H, W, 3) uint8 what it should be; its rows may be part of a larger image's.
        terms: weights by name of ``registry.LOSSES``.
    """
    if image.dtype != torch.float32 or image.device.type != "cpu":
        return photometric_loss_reference(image, pixels.float() / 255, terms, weight)
    image = image.detach().contiguous()
    gradient, cells = torch.empty_like(image), image.new_empty([-(-length // CELL) for length in pixels.shape[:2]])
    truth = torch.empty_like(image) if any(terms.values()) else None
    parts = {"l1": weight * l1_loss(image, pixels.numpy(), weight, gradient, cells, truth)}
    for name, share in terms.items():
        if truth is None or not share:
            continue
        if name == "square":
            difference = image - truth
            part = float(difference.square().mean())
            gradient.add_(difference, alpha=2 * weight * share / difference.numel())
        elif name == "dssim":
            slope = torch.empty_like(image)
            part = (1 - native_ssim(image, truth, slope)) / 2
            gradient.sub_(slope, alpha=weight * share / 2)
        else:
            part = float(_add_derived(name, weight * share, image, truth, gradient))
        parts[name] = parts.get(name, 0.0) + weight * share * part
    return PhotometricLoss(gradient, lambda: Figures(parts, cells))


def _by_kernels(
    image: Image,
    truth: Truth,
    alpha_weight: float,
    terms: Mapping[str, float],
    weight: float,
    state: torch.Tensor | None,
) -> PhotometricLoss:
    rgb, square, similar = image.rgb.detach().contiguous(), terms.get("square", 0.0), terms.get("dssim", 0.0)
    weights = weight, weight * square, -weight * similar / 2, weight * alpha_weight
    alphas = image.alpha.detach(), truth.alpha
    gradient, by_alpha, report = compare((rgb, truth.pixels), alphas, truth.ignored, weights, truth.empty_weight, state)
    arriving, others = OnItsWay(report), dict[str, OnItsWay]()
    for name, share in terms.items():
        if share and name not in ("square", "dssim"):
            shown = rgb if truth.ignored is None else rgb.masked_fill(truth.ignored[..., None], 0)
            slopes = torch.zeros_like(gradient)
            others[name] = OnItsWay(_add_derived(name, weight * share, shown, truth.colors, slopes))
            _weigh(slopes, truth)
            gradient.add_(slopes)

    def figures() -> Figures:
        drawn, cells, (absolute, squared, similarity, alpha) = read(arriving.here(), *rgb.shape[:2])
        values = {"square": squared, "dssim": (1 - similarity) / 2}
        values |= {name: float(value.here()) for name, value in others.items()}
        parts = {"l1": weight * absolute}
        for name, share in terms.items():
            if share:
                parts[name] = parts.get(name, 0.0) + weight * share * values[name]
        if by_alpha is not None:
            parts["alpha"] = weight * alpha_weight * alpha
        return Figures(parts, cells, drawn)

    return PhotometricLoss(gradient, figures, by_alpha)


def _add_derived(
    name: str, weight: float, image: torch.Tensor, truth: torch.Tensor, gradient: torch.Tensor
) -> torch.Tensor:
    """Adds ``weight`` times the gradient of a term that torch derives; returns the term ()."""
    with torch.enable_grad():
        drawn = image.clone().requires_grad_()
        value = term(name, drawn, truth)
        (slope,) = torch.autograd.grad(value, drawn)
    gradient.add_(slope, alpha=weight)
    return value.detach()


def photometric_loss_reference(
    image: torch.Tensor, truth: torch.Tensor, terms: Mapping[str, float], weight: float
) -> PhotometricLoss:
    """``photometric_loss`` in plain torch, on any device and in any floating-point type; ``truth`` in [0, 1]."""
    with torch.enable_grad():
        image = image.detach().requires_grad_()
        loss = weight * l1(image, truth)
        parts = {"l1": loss.detach()}
        for name, share in terms.items():
            if share:
                part = weight * share * term(name, image, truth)
                loss = loss + part
                parts[name] = parts[name] + part.detach() if name in parts else part.detach()
        (gradient,) = torch.autograd.grad(loss, image)
    squares = (image.detach() - truth).square().permute(2, 0, 1)
    cells = functional.avg_pool2d(squares, CELL, ceil_mode=True, count_include_pad=False).mean(0)
    arriving = OnItsWay(torch.cat([torch.stack(list(parts.values())), cells.flatten()]))

    def figures() -> Figures:
        values, errors = arriving.here().split([len(parts), cells.numel()])
        return Figures(dict(zip(parts, values.tolist(), strict=True)), errors.view(cells.shape))

    return PhotometricLoss(gradient, figures)


def term(name: str, image: torch.Tensor, truth: torch.Tensor) -> torch.Tensor:
    """A term of the loss; FrogError where it is no number that depends on ``image``."""
    value: object = LOSSES[name](image, truth)
    if not isinstance(value, torch.Tensor) or value.numel() != 1 or not value.requires_grad:
        given = f"a tensor of shape {tuple(value.shape)}" if isinstance(value, torch.Tensor) else type(value).__name__
        raise FrogError(f"The loss {name!r} gave {given}, expected a tensor of one number, derived from the drawing.")
    return value


def l1(image: torch.Tensor, truth: torch.Tensor) -> torch.Tensor:
    """The mean absolute difference, which every loss begins with."""
    return (image - truth).abs().mean()


def square(image: torch.Tensor, truth: torch.Tensor) -> torch.Tensor:
    """The mean squared difference, for what is missing: by ``l1`` a place that is wrong by half of the range pulls no
    more than one that is wrong by a grey level."""
    return (image - truth).square().mean()


def dssim(image: torch.Tensor, truth: torch.Tensor) -> torch.Tensor:
    """Half of what structural similarity lacks."""
    return (1 - ssim(image, truth)) / 2


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
    kernel = launch.sent(_kernel().to(moments.dtype), moments.device)
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
