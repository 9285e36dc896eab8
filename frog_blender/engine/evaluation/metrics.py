"""PSNR, SSIM and FLIP on numpy images; no torch."""

from __future__ import annotations

import numpy as np

_WINDOW, _SIGMA = 11, 1.5


def psnr_of(mean_squared_error: float) -> float:
    """Decibels for images in [0, 1]; 100 where they are equal, NaN where there is no number."""
    if np.isnan(mean_squared_error):
        return float("nan")  # comparisons below would take it for perfection
    return min(100.0, -10.0 * float(np.log10(max(mean_squared_error, 1e-10))))


def psnr(image: np.ndarray, truth: np.ndarray) -> float:
    """Of (H, W, 3) images in [0, 1]."""
    return psnr_of(float(np.mean((image.astype(np.float64) - truth) ** 2)))


def ssim(image: np.ndarray, truth: np.ndarray) -> float:
    """Mean structural similarity of (H, W, 3) images in [0, 1], with the window of 3DGS (11 pixels, sigma 1.5)."""
    import cv2

    def smooth(image: np.ndarray) -> np.ndarray:
        return cv2.GaussianBlur(image, (_WINDOW, _WINDOW), _SIGMA, borderType=cv2.BORDER_CONSTANT)

    # BORDER_CONSTANT in GaussianBlur means zeros, as the padding of the original's convolution.
    x, y = image.astype(np.float64), truth.astype(np.float64)
    mean_x, mean_y = smooth(x), smooth(y)
    variance_x, variance_y = smooth(x * x) - mean_x**2, smooth(y * y) - mean_y**2
    covariance = smooth(x * y) - mean_x * mean_y
    c1, c2 = 0.01**2, 0.03**2
    numerator = (2 * mean_x * mean_y + c1) * (2 * covariance + c2)
    return float((numerator / ((mean_x**2 + mean_y**2 + c1) * (variance_x + variance_y + c2))).mean())


def flip(image: np.ndarray, truth: np.ndarray) -> float:
    """Mean FLIP error of (H, W, 3) images in [0, 1], 0 for equal ones (Andersson et al. 2020, for a viewer that sees
    67 pixels a degree). ModuleNotFoundError where the package ``flip-evaluator`` is missing."""
    import flip_evaluator

    images = (np.ascontiguousarray(image, np.float32) for image in (truth, image))
    return float(flip_evaluator.evaluate(*images, "LDR", applyMagma=False)[1])


def gradient_energy(image: np.ndarray, mask: np.ndarray | None = None) -> float:
    """How sharp an image is: its mean squared brightness gradient, inside ``mask`` (H, W) if given."""
    grey = image.astype(np.float64).mean(axis=2)
    energy = np.zeros_like(grey)
    energy[:, :-1] += np.diff(grey, axis=1) ** 2
    energy[:-1] += np.diff(grey, axis=0) ** 2
    return float(energy[mask].mean() if mask is not None else energy.mean())
