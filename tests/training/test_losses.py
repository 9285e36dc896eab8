"""Structural similarity in the native library against plain torch in float64."""

from __future__ import annotations

import pytest
import torch

from frog_blender.engine.rasterizer import native
from frog_blender.engine.training.losses import ssim, ssim_plainly

# Smaller than the window, one row or column, strips of rows that are full, cut, and one row long.
SIZES = [(1, 1), (5, 7), (1, 40), (40, 1), (32, 20), (33, 17), (70, 90)]


def pictures(height: int, width: int) -> tuple[torch.Tensor, torch.Tensor]:
    generator = torch.Generator().manual_seed(height * 100 + width)
    truth = torch.rand(height, width, 3, generator=generator)
    image = (truth + 0.2 * torch.randn(height, width, 3, generator=generator)).clamp(0, 1)
    return image.requires_grad_(), truth


@pytest.mark.parametrize("size", SIZES)
def test_value_and_gradient(size: tuple[int, int]) -> None:
    image, truth = pictures(*size)
    found = ssim(image, truth)
    (2 * found).backward()
    exact = image.detach().double().requires_grad_()
    expected = ssim_plainly(exact, truth.double())
    (2 * expected).backward()
    assert abs(float(found.detach()) - float(expected.detach())) < 1e-6
    assert float((image.grad - exact.grad).norm() / exact.grad.norm()) < 1e-5


def test_equal_pictures() -> None:
    image, _ = pictures(50, 60)
    value = ssim(image, image.detach().clone())
    value.backward()
    assert float(value.detach()) == pytest.approx(1, abs=1e-6)
    assert float(image.grad.abs().max()) < 1e-6


def test_a_picture_that_is_not_contiguous() -> None:
    image, truth = pictures(40, 30)
    found = ssim(image.transpose(0, 1), truth.transpose(0, 1))
    assert float(found.detach()) == pytest.approx(float(ssim(image, truth).detach()), abs=1e-6)


def test_the_same_bits_on_any_number_of_threads() -> None:
    results = []
    for threads in (1, 2, 7):
        native.set_thread_count(threads)
        image, truth = pictures(100, 64)
        value = ssim(image, truth)
        value.backward()
        results.append((float(value.detach()), image.grad))
    native.set_thread_count(0)
    for value, gradient in results[1:]:
        assert value == results[0][0] and torch.equal(gradient, results[0][1])
