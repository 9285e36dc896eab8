"""Metrics: values by hand; FLIP and LPIPS where they can be computed, the reason where not, never a download."""

import sys
import types
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from support.builders import refused

from frog_blender.engine.evaluation import perceptual
from frog_blender.engine.evaluation.metrics import flip, gradient_energy, psnr, psnr_fitted, psnr_of, ssim
from frog_blender.engine.evaluation.perceptual import is_installed, lpips, lpips_vgg, perceptual_metrics


def test_psnr() -> None:
    truth = np.random.default_rng(0).random((20, 30, 3)).astype(np.float32)
    assert psnr(truth, truth) == 100
    assert psnr(truth + np.float32(0.1), truth) == pytest.approx(20, abs=1e-4)
    assert psnr(truth + np.float32(0.01), truth) == pytest.approx(40, abs=1e-2)
    assert psnr_of(1.0) == 0 and psnr_of(0.0) == 100
    assert np.isnan(psnr_of(float("nan"))) and psnr_of(float("inf")) < -1e9


def test_a_fitted_psnr_does_not_count_exposure() -> None:
    truth = np.random.default_rng(0).uniform(0.1, 0.9, (12, 16, 3))
    noisy = truth + np.random.default_rng(1).normal(0, 0.01, truth.shape)
    tinted = noisy * np.array([1.1, 0.9, 1.0])
    assert psnr_fitted(tinted, truth) == pytest.approx(psnr_fitted(noisy, truth), abs=1e-9)
    assert psnr(tinted, truth) < 30 < 39 < psnr(noisy, truth) <= psnr_fitted(noisy, truth)
    assert psnr_fitted(np.zeros_like(truth), truth) == psnr(np.zeros_like(truth), truth)


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


IMAGE = np.random.default_rng(0).random((40, 48, 3)).astype(np.float32)


def test_flip_is_zero_for_equal_images_and_grows_with_the_error() -> None:
    pytest.importorskip("flip_evaluator")
    noise = np.random.default_rng(1).normal(size=IMAGE.shape)
    errors = [flip((IMAGE + size * noise).clip(0, 1), IMAGE.astype(np.float64)) for size in (0, 0.05, 0.2)]
    assert errors[0] == 0 and 0 < errors[1] < errors[2] < 1
    dark, bright = np.zeros((8, 8, 3)), np.ones((8, 8, 3))
    assert flip(dark, bright) > 0.9, "black for white is nearly the largest error there is"


def install(monkeypatch: pytest.MonkeyPatch, *packages: str) -> None:
    """As if these were installed, and nothing else."""
    monkeypatch.setattr(perceptual, "is_installed", packages.__contains__)


def test_missing_packages_are_named(monkeypatch: pytest.MonkeyPatch) -> None:
    assert is_installed("numpy") and not is_installed("a_package_that_nobody_has")
    install(monkeypatch)
    assert perceptual_metrics() == ({}, dict.fromkeys(("flip", "lpips", "lpips_vgg"), "not installed"))
    install(monkeypatch, "flip_evaluator", "torch", "lpips")
    metrics, missing = perceptual_metrics()
    assert list(metrics) == ["flip"] and missing == dict.fromkeys(("lpips", "lpips_vgg"), "not installed")


@pytest.fixture
def fake_lpips(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> list[dict[str, Any]]:
    """A package of that name whose distance is the mean difference; the list has the options of each network built."""
    asked: list[dict[str, Any]] = []

    class LPIPS(torch.nn.Module):
        def __init__(self, **options: Any) -> None:
            super().__init__()
            asked.append(options)

        def forward(self, first: torch.Tensor, second: torch.Tensor) -> torch.Tensor:
            assert first.shape == second.shape == (1, 3, 40, 48)
            assert min(first.min(), second.min()) >= -1
            return (first - second).abs().mean().reshape(1, 1, 1, 1)

    module = types.ModuleType("lpips")
    module.LPIPS = LPIPS  # type: ignore[attr-defined]
    monkeypatch.setitem(sys.modules, "lpips", module)
    monkeypatch.setenv("TORCH_HOME", str(tmp_path))
    install(monkeypatch, "torch", "torchvision", "lpips")
    perceptual._network.cache_clear()
    return asked


def test_lpips_without_its_weights_is_not_even_built(fake_lpips: list[dict[str, Any]]) -> None:
    metrics, missing = perceptual_metrics()
    assert not metrics.keys() & {"lpips", "lpips_vgg"} and missing["lpips"] == "weights missing"
    refused("weights missing", lpips, IMAGE, IMAGE)
    assert fake_lpips == [], "building it would fetch the weights"


def test_lpips_with_its_weights(fake_lpips: list[dict[str, Any]], tmp_path: Path) -> None:
    weights = tmp_path / "hub" / "checkpoints" / "alexnet-owt-7be5be79.pth"
    weights.parent.mkdir(parents=True)
    weights.write_bytes(b"")
    assert list(perceptual_metrics()[0]) == ["lpips"]
    assert lpips(IMAGE, IMAGE) == 0
    assert lpips(np.ones_like(IMAGE), np.zeros_like(IMAGE)) == pytest.approx(2.0)
    assert np.isnan(lpips(IMAGE[:20], IMAGE[:20])), "too small for the network"
    assert [options["net"] for options in fake_lpips] == ["alex"], "built once"
    refused("weights missing", lpips_vgg, IMAGE, IMAGE)
    weights.with_name("vgg16-397923af.pth").write_bytes(b"")
    assert list(perceptual_metrics()[0]) == ["lpips", "lpips_vgg"]
    assert lpips_vgg(np.ones_like(IMAGE), np.zeros_like(IMAGE)) == pytest.approx(2.0)
    assert [options["net"] for options in fake_lpips] == ["alex", "vgg"]
