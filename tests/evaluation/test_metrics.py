"""Figures that can be computed by hand."""

from __future__ import annotations

import numpy as np
import pytest

from frog_blender.engine.evaluation.metrics import gradient_energy, psnr, psnr_of, ssim


def test_psnr() -> None:
    truth = np.random.default_rng(0).random((20, 30, 3)).astype(np.float32)
    assert psnr(truth, truth) == 100
    assert psnr(truth + np.float32(0.1), truth) == pytest.approx(20, abs=1e-4)
    assert psnr(truth + np.float32(0.01), truth) == pytest.approx(40, abs=1e-2)
    assert psnr_of(1.0) == 0 and psnr_of(0.0) == 100
    assert np.isnan(psnr_of(float("nan"))) and psnr_of(float("inf")) < -1e9


def test_ssim_of_equal_images_is_one_and_falls_with_noise() -> None:
    random = np.random.default_rng(0)
    truth = random.random((40, 50, 3))
    values = [ssim(truth + random.normal(0, s, truth.shape), truth) for s in (0.0, 0.02, 0.1, 0.5)]
    assert values[0] == pytest.approx(1, abs=1e-12)
    assert values[0] > values[1] > values[2] > values[3] > 0


def test_ssim_against_the_definition_with_zeros_outside() -> None:
    """Direct sums over the 11 x 11 window at one pixel, at a corner and inside."""
    random = np.random.default_rng(1)
    image, truth = random.random((2, 12, 14, 3))
    offsets = np.arange(-5, 6)
    kernel = np.exp(-(offsets**2) / (2 * 1.5**2))
    kernel /= kernel.sum()
    window = kernel[:, None] * kernel[None]
    x, y = (np.pad(image, ((5, 5), (5, 5), (0, 0))) for image in (image, truth))
    values = []
    for row in range(12):
        for column in range(14):
            a, b = (image[row : row + 11, column : column + 11] for image in (x, y))

            def mean(values: np.ndarray) -> np.ndarray:
                return np.einsum("ij,ijc->c", window, values)

            ma, mb = mean(a), mean(b)
            va, vb, cov = mean(a * a) - ma**2, mean(b * b) - mb**2, mean(a * b) - ma * mb
            c1, c2 = 1e-4, 9e-4
            values.append((2 * ma * mb + c1) * (2 * cov + c2) / ((ma**2 + mb**2 + c1) * (va + vb + c2)))
    assert ssim(image, truth) == pytest.approx(np.mean(values), abs=1e-6)


def test_sharpness_falls_with_blur() -> None:
    import cv2

    sharp = (np.indices((32, 32)).sum(0) % 4 < 2).astype(np.float64)[:, :, None].repeat(3, 2)
    blurred = cv2.GaussianBlur(sharp, (5, 5), 1.0)
    assert gradient_energy(blurred) < 0.5 * gradient_energy(sharp)
    mask = np.zeros((32, 32), bool)
    mask[:16] = True
    half = sharp.copy()
    half[16:] = 0.5
    assert gradient_energy(half, ~mask) < 0.1 * gradient_energy(half, mask)
    assert gradient_energy(np.full((4, 4, 3), 0.7)) == 0
