"""PSNR, SSIM and FLIP of numpy images; no torch."""

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

Image = NDArray[np.float32] | NDArray[np.float64]
"""(H, W, 3) display-referred sRGB in [0, 1]."""
Metric = Callable[[Image, Image], float]
"""A number for an image and its ground truth."""

SPLITS = {"held-out": "held-out", "test": "held-out", "val": "held-out", "training": "training", "train": "training"}
"""What images are scored: the two kinds by the names that they have in reports, and by those of others."""

_WINDOW, _SIGMA = 11, 1.5


def psnr_of(mean_squared_error: float) -> float:
    """PSNR in dB for images in [0, 1]: at most 100, NaN for a NaN."""
    if np.isnan(mean_squared_error):
        return float("nan")  # min and max below would turn it into 100
    return min(100.0, -10.0 * float(np.log10(max(mean_squared_error, 1e-10))))


def psnr(image: Image, truth: Image) -> float:
    """PSNR in dB of (H, W, 3) images in [0, 1]."""
    return psnr_of(float(np.mean((image.astype(np.float64) - truth) ** 2)))


def psnr_fitted(image: Image, truth: Image) -> float:
    """PSNR in dB after the factors of red, green and blue that fit best: what is left when a held-out camera's exposure
    and white balance, which no training image shows, do not count."""
    drawn, true = image.astype(np.float64), truth.astype(np.float64)
    gains = (drawn * true).sum((0, 1)) / np.maximum((drawn**2).sum((0, 1)), 1e-12)
    return psnr(drawn * gains, true)


def ssim(image: Image, truth: Image) -> float:
    """Mean SSIM of (H, W, 3) images in [0, 1] (Wang et al. 2004), with the window of 3DGS (11 pixels, sigma 1.5)."""
    import cv2

    def smooth(image: Image) -> NDArray[np.float64]:
        # BORDER_CONSTANT pads with zeros, as the convolution of 3DGS does.
        smoothed: NDArray[np.float64] = cv2.GaussianBlur(
            image, (_WINDOW, _WINDOW), _SIGMA, borderType=cv2.BORDER_CONSTANT
        )
        return smoothed

    x, y = image.astype(np.float64), truth.astype(np.float64)
    mean_x, mean_y = smooth(x), smooth(y)
    variance_x, variance_y = smooth(x * x) - mean_x**2, smooth(y * y) - mean_y**2
    covariance = smooth(x * y) - mean_x * mean_y
    c1, c2 = 0.01**2, 0.03**2
    numerator = (2 * mean_x * mean_y + c1) * (2 * covariance + c2)
    return float((numerator / ((mean_x**2 + mean_y**2 + c1) * (variance_x + variance_y + c2))).mean())


def flip(image: Image, truth: Image) -> float:
    """Mean FLIP error of (H, W, 3) images in [0, 1], 0 for equal ones (Andersson et al. 2020), at 67 pixels a degree.

    Raises:
        ModuleNotFoundError: if the package ``flip-evaluator`` is missing.
    """
    import flip_evaluator

    images = (np.ascontiguousarray(image, np.float32) for image in (truth, image))
    return float(flip_evaluator.evaluate(*images, "LDR", applyMagma=False)[1])


def gradient_energy(image: Image, mask: NDArray[np.bool_] | None = None) -> float:
    """Sharpness of an (H, W, 3) image: its mean squared brightness gradient, within ``mask`` (H, W) if given."""
    grey = image.astype(np.float64).mean(axis=2)
    energy = np.zeros_like(grey)
    energy[:, :-1] += np.diff(grey, axis=1) ** 2
    energy[:-1] += np.diff(grey, axis=0) ** 2
    return float(energy[mask].mean() if mask is not None else energy.mean())
