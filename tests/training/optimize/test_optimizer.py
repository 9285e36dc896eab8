"""Adam in native code, and rates and memory of parameters whose rows change."""

import subprocess
import sys
from collections.abc import Callable
from typing import Any

import pytest
import torch
from support.builders import refused
from support.random_models import built
from support.training_steps import OnlyGaussians

from frog_blender.engine.model.canonical import ATTRIBUTES, CanonicalField, new_gaussians
from frog_blender.engine.recipes import RECIPES, recipe
from frog_blender.engine.training.optimize.gaussian_state import GaussianState
from frog_blender.engine.training.optimize.optimizer import NativeAdam, SceneOptimizer

COUNT, MOVING = 12, 8


def values_of(count: int, first: float) -> dict[str, torch.Tensor]:
    """Attributes whose every number says whose it is: ``first``, ``first`` + 1 and so on."""
    values = new_gaussians(torch.zeros(count, 3), torch.zeros(count, 3), torch.ones(count), 4, 3)
    rows = torch.arange(first, first + count)
    return {name: rows.view(-1, *[1] * (value.dim() - 1)).expand_as(value).clone() for name, value in values.items()}


def scene() -> GaussianState:
    """Twelve Gaussians, of which eight move, whose Adam remembers of each which one it is."""
    values = values_of(COUNT, 1.0)
    canonical = CanonicalField(values | {"embeddings": values["embeddings"][:MOVING]})
    gaussians = GaussianState(OnlyGaussians(canonical), RECIPES["draft"], 1.0)
    for name in ATTRIBUTES:
        parameter = getattr(canonical, name)
        parameter.grad = parameter.detach().clone()
    gaussians.optimizer.step()
    for group in gaussians.optimizer.adam.param_groups:
        for parameter in group["params"]:
            parameter.data[...] = torch.arange(1.0, len(parameter) + 1).view(-1, *[1] * (parameter.dim() - 1))
    return gaussians


def told(array: torch.Tensor) -> list[float]:
    """The number that a Gaussian's every number is, for each."""
    rows = array.detach()[:, None].flatten(1)
    assert (rows == rows[:, :1]).all()
    return rows[:, 0].tolist()


@pytest.mark.parametrize(
    ("leaving", "movers", "resting", "expected"),
    [
        ([], 0, 0, [1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12]),
        ([2], 1, 0, [1, 2, 101, 4, 5, 6, 7, 8, 9, 10, 11, 12]),
        ([2, 9], 1, 1, [1, 2, 101, 4, 5, 6, 7, 8, 9, 102, 11, 12]),
        ([2, 9], 2, 0, [1, 2, 101, 4, 5, 6, 7, 8, 102, 9, 11, 12]),
        ([1, 4, 6], 2, 0, [1, 101, 3, 4, 102, 6, 8, 9, 10, 11, 12]),
        ([3], 3, 2, [1, 2, 3, 101, 5, 6, 7, 8, 102, 103, 9, 10, 11, 12, 104, 105]),
        ([*range(MOVING)], 0, 1, [9, 10, 11, 12, 101]),
        ([*range(COUNT)], 3, 1, [101, 102, 103, 104]),
    ],
)
def test_new_gaussians_take_the_rows_that_become_free(
    leaving: list[int], movers: int, resting: int, expected: list[int]
) -> None:
    gaussians = scene()
    canonical, optimizer = gaussians.canonical, gaussians.optimizer
    keep = torch.tensor([i for i in range(COUNT) if i not in leaving], dtype=torch.int64)
    new = values_of(movers + resting, 101.0)
    gaussians.replace(keep, new | {"embeddings": new["embeddings"][:movers]})
    moving = MOVING - sum(i < MOVING for i in leaving) + movers
    for name in ATTRIBUTES:
        parameter = getattr(canonical, name)
        mine = expected[:moving] if name == "embeddings" else expected
        assert told(parameter) == mine, name
        (group,) = (group for group in optimizer.adam.param_groups if group["name"] == name)
        assert len(group["params"]) == 1 and group["params"][0] is parameter
        state = optimizer.adam.state[parameter]
        remembered = [0.0 if i > 100 else float(i) for i in mine]
        torch.testing.assert_close(torch.tensor(told(10 * state["exp_avg"])), torch.tensor(remembered))
        squares = torch.tensor(remembered).square()
        torch.testing.assert_close(torch.tensor(told(1000 * state["exp_avg_sq"])), squares, rtol=1e-4, atol=0)
        assert state["step"] == 1 and len(optimizer.adam.state) == len(ATTRIBUTES)


# One number, nothing at all, several pieces of a thread's work with a rest, several dimensions.
SHAPES = [(1,), (0, 3), (20_001,), (300, 4, 3), (2, 2)]


def parameters() -> list[torch.nn.Parameter]:
    generator = torch.Generator().manual_seed(0)
    return [torch.nn.Parameter(torch.randn(shape, generator=generator)) for shape in SHAPES]


def gradients(step: int) -> list[torch.Tensor | None]:
    """Of very different sizes; some rows never pulled at, one parameter not in every step."""
    generator = torch.Generator().manual_seed(100 + step)
    arrays: list[torch.Tensor | None] = [torch.randn(shape, generator=generator) for shape in SHAPES]
    assert arrays[2] is not None and arrays[3] is not None
    arrays[2] *= 10.0 ** torch.randint(-12, 6, (20_001,), generator=generator)
    arrays[3][:100] = 0
    if step % 3 == 0:
        arrays[4] = None
    return arrays


def trained(kind: type[Any], steps: int = 40) -> tuple[list[torch.nn.Parameter], Any]:
    learned = parameters()
    optimizer = kind([{"params": learned[:2], "lr": 0.1}, {"params": learned[2:]}], lr=1e-3, eps=1e-15)
    for step in range(steps):
        for parameter, gradient in zip(learned, gradients(step), strict=True):
            parameter.grad = gradient
        optimizer.param_groups[1]["lr"] = 1e-3 * 0.95**step
        optimizer.step()
    return learned, optimizer


def largest_gradients(steps: int = 40) -> list[torch.Tensor]:
    """By parameter, of each number the largest size that its gradient had."""
    largest = [torch.zeros(shape) for shape in SHAPES]
    for step in range(steps):
        for size, gradient in zip(largest, gradients(step), strict=True):
            if gradient is not None:
                torch.maximum(size, gradient.abs(), out=size)
    return largest


def test_the_same_steps_and_memory_as_torch() -> None:
    """A mean of changing gradients may be small beside them, and is as exact as they are large."""
    (stepped, ours), (expected, theirs) = trained(NativeAdam), trained(torch.optim.Adam)
    for one, other, largest in zip(stepped, expected, largest_gradients(), strict=True):
        torch.testing.assert_close(one, other, rtol=1e-5, atol=1e-6)
        for name, size in (("exp_avg", largest), ("exp_avg_sq", largest.square())):
            difference = (ours.state[one][name] - theirs.state[other][name]).abs()
            assert bool((difference <= 2e-7 * size).all()), name
        assert ours.state[one]["step"] == int(theirs.state[other]["step"])
    assert torch.equal(stepped[3][:100], parameters()[3][:100])  # never pulled at: never moved


def test_the_same_bits_on_any_number_of_threads(same_on_threads: Callable[..., None]) -> None:
    same_on_threads(lambda: [parameter.detach() for parameter in trained(NativeAdam, 5)[0]])


@pytest.mark.parametrize(
    "values",
    [
        torch.ones(3, dtype=torch.float64),
        torch.ones(3, dtype=torch.float16),
        torch.ones(2, 3).T,
        torch.ones(3).to("meta"),
    ],
    ids=["double", "half", "strided", "elsewhere"],
)
def test_parameters_that_native_code_cannot_take_are_refused(values: torch.Tensor) -> None:
    parameter = torch.nn.Parameter(values)
    parameter.grad = torch.ones_like(parameter)
    with pytest.raises(TypeError, match="expected contiguous float32 on the CPU"):
        NativeAdam([{"params": [parameter]}], lr=0.1).step()


def test_a_gradient_of_another_size_is_refused() -> None:
    parameter = torch.nn.Parameter(torch.ones(5))
    parameter.grad = torch.ones(5)
    parameter.data = torch.ones(50_000)
    with pytest.raises(TypeError, match="gradient of 50000 numbers, found 5"):
        NativeAdam([{"params": [parameter]}], lr=0.1).step()


def test_it_loads_no_compiler() -> None:
    """Which takes seconds, and crashes some Blenders (with Triton's LLVM)."""
    code = (
        "import sys, torch\n"
        "from frog_blender.engine.training.optimize.optimizer import NativeAdam\n"
        "parameter = torch.nn.Parameter(torch.ones(3))\n"
        "parameter.grad = torch.ones(3)\n"
        "NativeAdam([{'params': [parameter], 'lr': 0.1}]).step()\n"
        "assert parameter.lt(1).all()\n"
        "sys.exit(any(name in sys.modules for name in ('torch._dynamo', 'triton')))\n"
    )
    subprocess.run([sys.executable, "-c", code], check=True)


@pytest.mark.parametrize(
    ("groups", "said"), [({}, "lacks temporal_table, deformation"), ({"netwrk": []}, "has netwrk, expected some of")]
)
def test_what_no_rate_drives_is_told(groups: dict[str, list[Any]], said: str, monkeypatch: pytest.MonkeyPatch) -> None:
    model = built("frog")
    monkeypatch.setattr(model, "rate_groups", lambda: groups)
    refused(said, SceneOptimizer, model, recipe("draft"), 1.0)
