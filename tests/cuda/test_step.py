"""The kernels of a training's step, compiled for the CPU: loss, Adam and what densification collects."""

import math
from collections.abc import Iterator
from types import SimpleNamespace
from typing import Any

import pytest
import torch
from emulated import Emulator
from support.builders import plain_camera

from frog_blender.engine.cuda import launch
from frog_blender.engine.cuda.sources import CHOICES, Kernel
from frog_blender.engine.errors import FrogError
from frog_blender.engine.training.optimize.densification import COLLECTED, DensityStrategy
from frog_blender.engine.training.optimize.losses import PhotometricLoss, matte_loss
from frog_blender.engine.training.optimize.mattes import Truth
from frog_blender.engine.training.optimize.neighbours import NeighbourGraph
from frog_blender.engine.training.optimize.optimizer import NativeAdam
from frog_blender.engine.training.optimize.trial import try_step

NO_ROOM, ROOM = torch.tensor([7, 1]), torch.tensor([7, 0])
SIZES = [(1, 1), (5, 7), (1, 40), (40, 1), (32, 16), (33, 50)]
TERMS = [{}, {"square": 3.0}, {"dssim": 0.4}, {"dssim": 0.4, "square": 3.0, "l1": 0.5}]


def images(height: int, width: int) -> tuple[torch.Tensor, torch.Tensor]:
    """A drawing, and the bytes it should be, a part of a larger image; some numbers are the same."""
    generator = torch.Generator().manual_seed(height * 100 + width)
    whole = torch.randint(256, (height + 3, width + 5, 3), generator=generator, dtype=torch.uint8)
    truth = whole[2 : 2 + height, 4 : 4 + width]
    drawn = (truth / 255 + 0.2 * torch.randn(truth.shape, generator=generator)).clip(0, 1)
    drawn[1::3, ::2] = truth[1::3, ::2] / 255
    return drawn, truth


def numbers(loss: PhotometricLoss) -> Iterator[torch.Tensor]:
    figures = loss.figures()
    yield from (loss.gradient, figures.cell_errors, torch.tensor([*figures.terms.values()], dtype=torch.float64))
    if loss.alpha_gradient is not None:
        yield loss.alpha_gradient


@pytest.mark.parametrize("masks", [(), ("alpha",), ("alpha", "ignored"), ("ignored",)], ids=str)
@pytest.mark.parametrize("terms", TERMS, ids=str)
@pytest.mark.parametrize("size", SIZES)
def test_loss(size: tuple[int, int], terms: dict[str, float], masks: tuple[str, ...], emulator: Emulator) -> None:
    drawn, pixels = images(*size)
    given = {"alpha": (2 * pixels[..., 0].float() - 255).clamp(min=0).to(torch.uint8)} if "alpha" in masks else {}
    if "ignored" in masks:
        given["ignored"] = pixels[..., 1] > 128
        pixels = pixels.masked_fill(given["ignored"][..., None], 0)
    truth = Truth(pixels, (0.0, 0.0, 0.0), **given, empty_weight=0.3)

    def loss(kind: torch.dtype, state: torch.Tensor | None = None) -> PhotometricLoss:
        image = SimpleNamespace(rgb=drawn.to(kind), alpha=(0.9 * drawn[..., 2] + 0.05).to(kind))
        return matte_loss(image, truth, 0.2, terms, 0.7, state)

    found, expected = loss(torch.float32, ROOM), loss(torch.float64)
    assert len(emulator.launched) == (2 if "dssim" in terms else 1)
    for one, other in zip(numbers(found), numbers(expected), strict=True):
        torch.testing.assert_close(one.double(), other.double(), rtol=1e-5, atol=1e-5 * float(other.abs().max()))
    assert found.figures().terms.keys() == expected.figures().terms.keys()
    assert list(found.figures().state) == ROOM.tolist()
    emulator.turned = True
    again = loss(torch.float32)
    assert all(torch.equal(*pair) for pair in zip(numbers(found), numbers(again), strict=True))
    assert list(again.figures().state) == [0, 0]


def test_a_drawing_that_is_no_number_shows(emulator: Emulator) -> None:
    drawn, pixels = images(20, 20)
    drawn[3, 4, 1] = torch.nan
    image = SimpleNamespace(rgb=drawn, alpha=drawn[..., 0])
    assert math.isnan(matte_loss(image, Truth(pixels, (0.0, 0.0, 0.0)), 0.2, {}, 1.0).figures().loss)


SHAPES = [(1,), (0, 3), (1025,), (30, 4, 3), *[(7,)] * 27]  # more than a launch takes


def trained(kind: type, dtype: torch.dtype, states: list[torch.Tensor]) -> tuple[list[torch.Tensor], dict]:
    """Parameters after a step for each state, of which a later one has no gradient in every third."""
    generator = torch.Generator().manual_seed(0)
    learned = [torch.nn.Parameter(torch.randn(shape, generator=generator).to(dtype)) for shape in SHAPES]
    optimizer = kind([{"params": learned[:2], "lr": 0.1}, {"params": learned[2:]}], lr=1e-3, eps=1e-15)
    for number, state in enumerate(states):
        for index, parameter in enumerate(learned):
            gradient = torch.randn(parameter.shape, generator=generator)
            parameter.grad = None if index == 3 and number % 3 == 0 else gradient.to(dtype)
        if kind is NativeAdam:
            optimizer.step(state)
        else:
            optimizer.step()
    return [parameter.detach() for parameter in learned], optimizer.state


def test_adam(emulator: Emulator) -> None:
    states = [ROOM] * 9
    found, state = trained(NativeAdam, torch.float32, states)
    assert len(emulator.launched) == 18
    expected, _ = trained(torch.optim.Adam, torch.float64, states)
    for one, other in zip(found, expected, strict=True):
        torch.testing.assert_close(one.double(), other, rtol=1e-5, atol=1e-6)
    assert [known["step"] for known in state.values()] == [9, 9, 9, *[9] * 27, 6]
    emulator.turned = True
    assert all(torch.equal(*pair) for pair in zip(found, trained(NativeAdam, torch.float32, states)[0], strict=True))


def test_adam_leaves_everything_as_it_is_where_a_drawing_had_no_room(emulator: Emulator) -> None:
    first, _ = trained(NativeAdam, torch.float32, [])
    found, state = trained(NativeAdam, torch.float32, [NO_ROOM] * 2)
    assert all(torch.equal(*pair) for pair in zip(first, found, strict=True))
    assert not any(known["exp_avg"].any() or known["exp_avg_sq"].any() for known in state.values())


@pytest.mark.parametrize("ignores", [False, True])
@pytest.mark.parametrize("with_gradient", [False, True])
def test_observation(ignores: bool, with_gradient: bool, emulator: Emulator, monkeypatch: pytest.MonkeyPatch) -> None:
    count, generator = 300, torch.Generator().manual_seed(1)
    opacities, weights, radii, *before = torch.rand(7, count, generator=generator)
    radii[::3] = 0
    screen = torch.rand(count, 2, generator=generator).requires_grad_()
    screen.grad = torch.rand(count, 2, generator=generator) if with_gradient else None
    ignored = torch.rand(count, generator=generator) < 0.5 if ignores else None
    image = SimpleNamespace(max_weights=weights, screen=screen, radii=radii)

    def collected(state: torch.Tensor | None = None) -> list[torch.Tensor]:
        statistics = dict(zip(COLLECTED, [each.clone() for each in before], strict=True))
        DensityStrategy.observe(SimpleNamespace(**statistics), image, opacities, plain_camera(48, 32), ignored, state)
        return list(statistics.values())

    found = collected(ROOM)
    assert len(emulator.launched) == 1
    assert all(torch.equal(*pair) for pair in zip(before, collected(NO_ROOM), strict=True))
    monkeypatch.setattr(launch, "on_gpu", lambda tensor: False)
    torch.testing.assert_close(found, collected())


@pytest.mark.parametrize(("width", "size"), [(5, None), (40, 36)])
def test_smoothness(width: int, size: int | None, emulator: Emulator, monkeypatch: pytest.MonkeyPatch) -> None:
    """Rows that are named many times, as anchors and as neighbours."""
    generator = torch.Generator().manual_seed(2)
    embeddings, before = torch.randn(2, 30, width, generator=generator)
    anchors = torch.randperm(30, generator=generator)[:20]
    neighbours = torch.randint(30, (20, 7), generator=generator)
    graph = NeighbourGraph(anchors, neighbours, torch.rand(20, 7, generator=generator))

    def added() -> torch.Tensor:
        embeddings.grad = before.clone()
        graph.add_gradient(embeddings, 0, 0.7, size)
        return embeddings.grad

    found = added()
    assert len(emulator.launched) == 1
    emulator.turned = True
    assert torch.equal(found, added())
    monkeypatch.setattr(launch, "on_gpu", lambda tensor: False)
    torch.testing.assert_close(found, added())


OUTPUTS = {
    "blend": 5,
    "loss": 9,
    "loss_backward": 8,
    "blend_backward": 10,
    "observe": 11,
    "smooth": 9,
    "windows": 8,
    "adam": None,
}
"""Where a kernel has an output that the trial looks at; Adam's are in a struct."""


@pytest.mark.parametrize("kernel", OUTPUTS)
def test_a_gpu_with_a_kernel_that_is_wrong_is_left_aside(
    kernel: str, emulator: Emulator, monkeypatch: pytest.MonkeyPatch
) -> None:
    right = emulator.launch

    def wrong(which: Kernel, blocks: int, *arguments: Any) -> None:
        output = OUTPUTS[kernel]
        if which.name != kernel or output is not None:
            right(which, blocks, *arguments)
        if which.name == kernel and output is not None:
            arguments[output].mul_(1.01)

    monkeypatch.setattr(emulator, "launch", wrong)
    with pytest.raises(FrogError, match=r"A step's .* is not what plain torch finds"):
        try_step(torch.device("cpu"))


def test_a_gpu_whose_kernels_are_right_is_taken(emulator: Emulator) -> None:
    try_step(torch.device("cpu"))
    assert {which.name for which in emulator.launched} == CHOICES.keys()
    emulator.turned = True
    try_step(torch.device("cpu"))
