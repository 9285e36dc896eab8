"""The loss of an image in the native library against plain torch in float64."""

from collections.abc import Callable

import numpy as np
import pytest
import torch

from frog_blender.engine.errors import FrogError
from frog_blender.engine.native import binding
from frog_blender.engine.registry import LOSSES
from frog_blender.engine.training.optimize.losses import PhotometricLoss, photometric_loss, photometric_loss_reference

# Smaller than the window and than a cell, one row or column, strips of rows that are full, cut, and one row long.
SIZES = [(1, 1), (5, 7), (1, 40), (40, 1), (32, 20), (33, 17), (16, 48), (70, 90)]


def images(height: int, width: int) -> tuple[torch.Tensor, torch.Tensor]:
    """A drawing, some of whose numbers are exactly those of the image beside it."""
    random = np.random.default_rng(height * 100 + width)
    truth = random.integers(0, 256, (height, width, 3), np.uint8)
    drawn = (truth / 255 + random.normal(0, 0.2, truth.shape)).clip(0, 1).astype(np.float32)
    drawn[1::3, ::2] = truth[1::3, ::2].astype(np.float32) / 255
    return torch.from_numpy(drawn), torch.from_numpy(truth)


def exactly(image: torch.Tensor, truth: torch.Tensor, terms: dict[str, float], weight: float) -> PhotometricLoss:
    """In float64, where what is equal in float32 must stay equal."""
    return photometric_loss_reference(image.double(), (truth.float() / 255).double(), terms, weight)


def fourth_powers(image: torch.Tensor, truth: torch.Tensor) -> torch.Tensor:
    return (image - truth).pow(4).mean()


@pytest.mark.parametrize(
    "terms",
    [{}, {"square": 3.0, "dssim": 0.0}, {"square": 0.0, "dssim": 0.4}, {"dssim": 0.4, "fourth": 2.0, "square": 3.0}],
    ids=str,
)
@pytest.mark.parametrize("size", SIZES)
def test_values_and_gradient(size: tuple[int, int], terms: dict[str, float]) -> None:
    image, truth = images(*size)
    LOSSES.register("fourth", fourth_powers)
    try:
        native = photometric_loss(image.requires_grad_(), truth, terms, 0.7)
        expected = exactly(image, truth, terms, 0.7)
    finally:
        LOSSES.unregister("fourth")
    figures, wanted = native.figures(), expected.figures()
    assert figures.terms == pytest.approx(wanted.terms, abs=1e-6)
    assert figures.terms.keys() == {"l1"} | {name for name, weight in terms.items() if weight}
    assert not any(tensor.requires_grad for tensor in (native.gradient, expected.gradient, figures.cell_errors))
    slope = expected.gradient
    assert float((native.gradient - slope).norm()) <= 1e-5 * float(slope.norm()) > 0
    np.testing.assert_allclose(figures.cell_errors, wanted.cell_errors, rtol=1e-5, atol=1e-9)


@pytest.mark.parametrize("wrong", [lambda image, _: image, lambda *_: 0.5, lambda *_: None])
@pytest.mark.parametrize("loss", [photometric_loss, exactly])
def test_a_term_that_is_no_number_is_named(wrong: Callable[..., object], loss: Callable[..., object]) -> None:
    LOSSES.register("wrong", wrong)
    try:
        with pytest.raises(FrogError, match=r"The loss 'wrong' gave .*, expected a tensor of one number"):
            loss(*images(*SIZES[0]), {"wrong": 1.0}, 1.0)
    finally:
        LOSSES.unregister("wrong")


def test_a_part_of_a_larger_image_and_a_drawing_that_is_not_contiguous() -> None:
    image, truth = images(60, 70)
    part = image[10:50, 20:60].contiguous()
    native = photometric_loss(part, truth[10:50, 20:60], {"dssim": 0.2}, 1.0)
    expected = photometric_loss(part, truth[10:50, 20:60].contiguous(), {"dssim": 0.2}, 1.0)
    assert native.figures().terms == expected.figures().terms
    assert torch.equal(native.figures().cell_errors, expected.figures().cell_errors)
    turned = truth.transpose(0, 1).contiguous()
    native = photometric_loss(image.transpose(0, 1), turned, {"dssim": 0.3}, 1.0)
    straight = photometric_loss(image, truth, {"dssim": 0.3}, 1.0)
    assert native.figures().loss == pytest.approx(straight.figures().loss, abs=1e-6)


@pytest.mark.parametrize("bad", [float("nan"), float("inf")])
def test_what_is_no_number_shows(bad: float) -> None:
    image, truth = images(20, 20)
    image[3, 4, 1] = bad
    assert not np.isfinite(photometric_loss(image, truth, {}, 1.0).figures().loss)


def test_the_same_bits_on_any_number_of_threads(same_on_threads: Callable[..., None]) -> None:
    def looked_at() -> tuple[float, torch.Tensor, torch.Tensor]:
        native = photometric_loss(*images(100, 64), {"dssim": 0.2}, 1.0)
        return native.figures().loss, native.gradient, native.figures().cell_errors

    same_on_threads(looked_at)


def test_what_does_not_fit_is_refused() -> None:
    """Native code only sees addresses."""
    image, truth = images(20, 33)[0], images(20, 33)[1].numpy()
    drawn, gradient, cells = image, torch.empty(20, 33, 3), torch.empty(2, 3)
    binding.l1_loss(drawn, truth, 1.0, gradient, cells)
    for arguments in (
        (drawn, truth.astype(np.float32), 1.0, gradient, cells),
        (drawn, truth[:, ::2], 1.0, torch.empty(20, 17, 3), torch.empty(2, 2)),
        (drawn, truth[:-1], 1.0, gradient, cells),
        (drawn, truth, 1.0, torch.empty(20, 32, 3), cells),
        (drawn, truth, 1.0, gradient, torch.empty(2, 2)),
        (drawn, truth, 1.0, gradient, cells, torch.empty(20, 33)),
    ):
        with pytest.raises(ValueError, match="expected"):
            binding.l1_loss(*arguments)
